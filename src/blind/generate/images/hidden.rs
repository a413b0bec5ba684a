//! What is hidden in pixels, at its size: its shape, and its parameters as result files name them.

use rand::Rng;

use super::super::kind::TrueParameter;
use super::super::random::{between, normal, on_circle, pick};
use super::camera::{ImageCamera, ImageWorld, SIZE_PX};
use super::charge;
use super::kind::PixelKind;

/// An effect at its size, in the direction that the numbers say.
#[derive(Clone, Debug, PartialEq)]
pub struct HiddenImage {
    /// What it is.
    pub kind: PixelKind,
    /// Its size, in the unit of its first parameter (or of its equation, where they differ).
    pub size: f64,
    /// Its shape, each kind's own.
    pub numbers: Vec<f64>,
}

/// All that is hidden in a recording.
#[derive(Clone, Copy, Debug)]
pub(super) struct Causes<'a>(pub(super) &'a [HiddenImage]);

impl Causes<'_> {
    pub(super) fn find(&self, kind: PixelKind) -> Option<&HiddenImage> {
        self.0.iter().find(|own| own.kind == kind && own.size != 0.0)
    }

    /// The size of an effect; zero where it is not hidden.
    pub(super) fn size(&self, kind: PixelKind) -> f64 {
        self.find(kind).map_or(0.0, |own| own.size)
    }
}

impl HiddenImage {
    /// Of a small size, with a shape drawn.
    pub(super) fn draw(kind: PixelKind, rng: &mut impl Rng, world: &ImageWorld) -> Self {
        let frames = world.frames.len();
        let numbers = match kind {
            // The part of the loss that is the rim's, and how much wider the rim is than the pupil.
            PixelKind::Vignetting => vec![between(rng, 0.3, 0.8), between(rng, 1.02, 1.2)],
            PixelKind::FieldTilt | PixelKind::StrayLight => on_circle(rng).to_vec(),
            // Time that traps hold a charge, in transfers; power of the volume.
            PixelKind::ChargeTransfer => vec![between(rng, 1.0, 4.0), between(rng, 0.4, 0.6)],
            PixelKind::AmplifierGlow => vec![pick(rng, 4) as f64, between(rng, 0.08, 0.2) * SIZE_PX as f64],
            PixelKind::FrameDimmer | PixelKind::ExposureTime => vec![pick(rng, frames) as f64],
            PixelKind::Jitter => (0..frames).map(|_| normal(rng).abs()).collect(),
            _ => Vec::new(),
        };
        Self { kind, size: kind.probe(&world.camera), numbers }
    }

    pub(super) fn number(&self, index: usize) -> f64 {
        self.numbers.get(index).copied().unwrap_or_default()
    }

    /// Whether a parameter of the diagnosis is this one, so that they can be compared. A response that is an exponential here is a parabola there: small
    /// losses are the same.
    #[must_use]
    pub fn is_comparable(kind: PixelKind, size: f64) -> bool {
        /// At which what the two differ by, two thirds of the square of the loss, is a fifteenth of the loss.
        const SMALL_LOSS: f64 = 0.1;
        use PixelKind::{AmplifierStep, CodeWidths, ColumnBanding, Crosstalk, DarkCurrent, EvenOdd, ExposureTime};
        use PixelKind::{Extinction, LostBits, Nonlinearity, Passband, Prnu, RowBanding, WrongGain};
        match kind {
            AmplifierStep | CodeWidths | ColumnBanding | Crosstalk | DarkCurrent | EvenOdd | ExposureTime | Extinction | LostBits
            | Passband | Prnu | RowBanding | WrongGain => true,
            Nonlinearity => size.abs() < SMALL_LOSS,
            _ => false,
        }
    }

    /// Its parameters as result files name them. `all`: what is hidden with it, which may change what a size is in counts.
    #[must_use]
    pub(super) fn parameters(&self, world: &ImageWorld, all: Causes<'_>) -> Vec<TrueParameter> {
        use PixelKind as K;
        let (s, camera) = (self.size, &world.camera);
        let gain = camera.gain_e_per_dn * (1.0 + all.size(K::WrongGain));
        // Root mean square of the gains of two halves.
        let step = 1.0 + all.size(K::AmplifierStep);
        let halves = f64::midpoint(1.0, step * step).sqrt();
        let sigma_per_blur = camera.blur_px / (4.0 * camera.profile.sigma_px.hypot(camera.blur_px / 2.0));
        let list: Vec<(&str, f64, &str)> = match self.kind {
            K::Vignetting => vec![("loss_at_corner", s, "")],
            K::Nonlinearity => vec![("relative_at_full", s, "")],
            K::BrighterFatter => vec![("relative_width_at_full", charge::relative_width_at_full(camera, s), "")],
            K::ChargeTransfer => vec![("loss_at_far_row_10000e", s, "")],
            K::Passband => vec![("mag_per_mag", s, "mag/mag")],
            K::Extinction => vec![("mag_per_airmass", s, "mag")],
            K::FieldTilt => vec![
                ("sigma_px_per_half_diagonal_x", s * self.number(0) * sigma_per_blur, "px"),
                ("sigma_px_per_half_diagonal_y", s * self.number(1) * sigma_per_blur, "px"),
            ],
            K::FieldCurvature => vec![("sigma_px_at_corner", s * sigma_per_blur, "px")],
            K::AxialColour => vec![("sigma_px_per_mag", s * sigma_per_blur, "px/mag")],
            K::FocusWithTemperature => vec![("sigma_px_per_kelvin", s * sigma_per_blur, "px/K")],
            K::FocusWithTime => vec![("sigma_px_per_hour", s * sigma_per_blur, "px/h")],
            K::Coma => vec![("coma_px_at_corner", s, "px")],
            K::AmplifierStep => vec![("gain_relative", s, "")],
            K::Prnu | K::ExposureTime | K::EvenOdd | K::Crosstalk | K::VeilingGlare | K::Bayer | K::Overshoot => vec![("relative", s, "")],
            K::HotPixels | K::RandomTelegraph => vec![("count", s.round(), "")],
            K::RowBanding => vec![("row_sigma_e", s, "e"), ("row_sigma_dn", s / gain, "DN")],
            K::ColumnBanding => vec![("column_sigma_e", s, "e"), ("column_sigma_dn", s / gain, "DN")],
            K::CodeWidths => vec![("dnl_dn", s, "DN")],
            K::LostBits => vec![("lost_bits", s.round(), "")],
            K::Compression => vec![("block_px", 8.0, "px"), ("quantiser_dn", s, "DN")],
            K::WrongGain => vec![("gain_ratio", 1.0 + s, "")],
            K::WrongReadNoise => vec![("read_noise_e", camera.read_noise_e + s, "e")],
            K::DarkCurrent => vec![("dark_e_per_px_s", s, "e/s"), ("unequal_dn_per_s", halves * s * charge::UNEQUAL_DARK / gain, "DN/s")],
            K::AmplifierGlow => vec![("corner", self.number(0), ""), ("e_per_px_s", s, "e/s")],
            K::CosmicRays | K::Streaks => vec![("per_frame", s, "")],
            K::MotionSmear => vec![("length_px", s * longest_smear_px(world), "px")],
            K::Jitter => vec![("sigma_px", s, "px")],
            K::IntrapixelResponse => vec![("edge_drop", s, "")],
            K::FrameDimmer => vec![("mag", s, "mag"), ("frame", self.number(0), "")],
            K::FieldStop => vec![("radius_px", (1.0 - s) * SIZE_PX as f64 / 2.0_f64.sqrt(), "px")],
            K::StrayLight => vec![("gradient_e_per_px", s / (SIZE_PX as f64 / 2.0), "e/px")],
        };
        list.into_iter().map(|(name, value, unit)| TrueParameter { name: name.to_owned(), value, unit: unit.to_owned() }).collect()
    }
}

/// The longest trail of a full exposure among the frames, px.
fn longest_smear_px(world: &ImageWorld) -> f64 {
    let length =
        |frame: &super::camera::Conditions| world.world.optics.focal_px * frame.rate_rad_s[0].hypot(frame.rate_rad_s[1]) * frame.exposure_s;
    world.frames.iter().map(length).fold(0.0, f64::max)
}

impl PixelKind {
    /// A size that changes little and is far above rounding: finite differences are taken with it.
    fn probe(self, camera: &ImageCamera) -> f64 {
        use PixelKind as K;
        match self {
            K::Vignetting
            | K::Nonlinearity
            | K::AmplifierStep
            | K::ExposureTime
            | K::IntrapixelResponse
            | K::ChargeTransfer
            | K::Passband
            | K::Extinction
            | K::FrameDimmer
            | K::FocusWithTemperature
            | K::FocusWithTime => 0.02,
            K::BrighterFatter | K::Crosstalk | K::Overshoot | K::VeilingGlare => 1e-3,
            K::FieldTilt | K::FieldCurvature | K::AxialColour | K::Coma | K::Jitter => 0.1,
            K::MotionSmear => 0.3,
            K::StrayLight => 0.2,
            K::RowBanding | K::ColumnBanding => 0.1 * camera.read_noise_e,
            _ => 1.0,
        }
    }
}
