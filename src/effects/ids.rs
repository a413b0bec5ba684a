//! Ids of the effects that other rooms call by name: the projections, the parts of every camera, what the sky does, the noises.

use super::{detector, motion, optics, sky};

/// See [`detector::bayer`].
pub const BAYER: &str = <detector::bayer::Bayer as super::CentroidShift>::ID;
/// See [`optics::brown_conrady`].
pub const BROWN_CONRADY: &str = <optics::brown_conrady::BrownConrady as super::Displacement>::ID;
/// See [`sky::chromatic_refraction`].
pub const CHROMATIC_REFRACTION: &str = <sky::chromatic_refraction::ChromaticRefraction as super::Displacement>::ID;
/// See [`optics::equidistant`].
pub const EQUIDISTANT: &str = <optics::equidistant::Equidistant as super::Displacement>::ID;
/// See [`optics::equisolid`].
pub const EQUISOLID: &str = <optics::equisolid::Equisolid as super::Displacement>::ID;
/// See [`optics::kannala_brandt`].
pub const KANNALA_BRANDT: &str = <optics::kannala_brandt::KannalaBrandt as super::Displacement>::ID;
/// See [`optics::pinhole`].
pub const PINHOLE: &str = <optics::pinhole::Pinhole as super::Displacement>::ID;
/// See [`detector::pixel_aspect`].
pub const PIXEL_ASPECT: &str = <detector::pixel_aspect::PixelAspect as super::Displacement>::ID;
/// See [`optics::projection`].
pub const PROJECTION: &str = <optics::projection::ProjectionMismatch as super::Displacement>::ID;
/// See [`sky::proper_motion`].
pub const PROPER_MOTION: &str = <sky::proper_motion::ProperMotion as super::Displacement>::ID;
/// See [`optics::quadratic_rest`].
pub const QUADRATIC_REST: &str = <optics::quadratic_rest::QuadraticRest as super::Displacement>::ID;
/// See [`optics::radial_high_order`].
pub const RADIAL_HIGH_ORDER: &str = <optics::radial_high_order::RadialHighOrder as super::Displacement>::ID;
/// See [`sky::refraction`].
pub const REFRACTION: &str = <sky::refraction::Refraction as super::Displacement>::ID;
/// See [`motion::rolling_shutter`].
pub const ROLLING_SHUTTER: &str = <motion::rolling_shutter::RollingShutter as super::Displacement>::ID;
/// See [`sky::stellar_aberration`].
pub const STELLAR_ABERRATION: &str = <sky::stellar_aberration::StellarAberration as super::Displacement>::ID;
/// See [`optics::stereographic`].
pub const STEREOGRAPHIC: &str = <optics::stereographic::Stereographic as super::Displacement>::ID;
/// See [`detector::stray_light`].
pub const STRAY_LIGHT: &str = <detector::stray_light::StrayLight as super::CentroidShift>::ID;
/// See [`detector::adc`].
pub const ADC: &str = <detector::adc::Adc as super::pixel::PixelEffect>::ID;
/// See [`sky::background`].
pub const BACKGROUND: &str = <sky::background::Background as super::pixel::PixelEffect>::ID;
/// See [`detector::banding`].
pub const BANDING: &str = <detector::banding::Banding as super::pixel::PixelEffect>::ID;
/// See [`detector::blooming`].
pub const BLOOMING: &str = <detector::blooming::Blooming as super::pixel::pass::PassHead>::ID;
/// See [`detector::dark_current`].
pub const DARK_CURRENT: &str = <detector::dark_current::DarkCurrent as super::pixel::PixelEffect>::ID;
/// See [`detector::hot_pixels`].
pub const HOT_PIXELS: &str = <detector::hot_pixels::HotPixels as super::pixel::PixelEffect>::ID;
/// See [`detector::nonlinearity`].
pub const NONLINEARITY: &str = <detector::nonlinearity::Nonlinearity as super::pixel::PixelEffect>::ID;
/// See [`detector::photon_noise`].
pub const PHOTON_NOISE: &str = <detector::photon_noise::PhotonNoise as super::pixel::PixelEffect>::ID;
/// See [`detector::random_telegraph`].
pub const RANDOM_TELEGRAPH: &str = <detector::random_telegraph::RandomTelegraph as super::pixel::PixelEffect>::ID;
/// See [`detector::read_noise`].
pub const READ_NOISE: &str = <detector::read_noise::ReadNoise as super::pixel::PixelEffect>::ID;
