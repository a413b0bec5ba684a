//! Recordings with effects hidden IN PIXELS: frames that are painted with an image, a sky and a detector of the generator's own.
//!
//! The star image is no Gaussian (`spread.rs`), catalogue and stars differ, and stars fainter than those of the list shine too. What is hidden
//! is painted from the equations of the primary sources (`light.rs`, `charge.rs`, `readout.rs`), at a size that Fisher information gives (`strength.rs`).

mod camera;
mod charge;
mod hidden;
pub(super) mod kind;
mod light;
mod readout;
mod spread;
mod strength;

use rand::Rng;
use rayon::prelude::*;

pub use camera::{Conditions, ImageCamera, ImageWorld, SkyStar};
pub use hidden::HiddenImage;
pub use kind::{IMAGE_GROUPS, IMAGE_KINDS, IMAGE_PAIRS, PixelKind, Reckoned};
pub use spread::PaintedProfile;

use super::family::{Family, IMAGE_TRAPS, PIXEL_LADDER, Trap};
use super::random::{chance, stream};
use super::truth::{TRUTH_FORMAT, TrueCamera, TrueEffect, Truth};
use super::{Concealed, FrameLine, Lists};
use crate::catalog::Catalog;
use crate::units::DEG_RAD;
use camera::Needs;
use charge::{Pixels, collected, moved};
use hidden::Causes;
use readout::{Electronics, amplified, counts};
use strength::{JUST_SEEN, Noiseless, noise_size};

/// Parts of a recording's random numbers.
const PART_WORLD: u32 = 16;
const PART_SIZES: u32 = 17;
const PART_PIXELS: u32 = 18;
const PART_ELECTRONICS: u32 = 19;
/// The first frame's noise takes this part; each frame has its own.
const PART_FRAMES: u32 = 1024;
/// Trials to find the size of a signal-to-noise ratio, and the power of the ratio by which a size is changed.
const MAX_TRIALS: usize = 12;
const STEP_POWER: f64 = 0.7;
/// Multiples of what is hidden together.
const TOGETHER: [f64; 2] = [4.0, 8.0];

/// All that frames are painted from.
#[derive(Clone, Debug, PartialEq)]
pub struct ImageCanvas {
    /// Camera, sky, frames.
    pub world: ImageWorld,
    /// What is hidden.
    pub hidden: Vec<HiddenImage>,
    seed: u64,
    family: u32,
    index: u32,
}

impl ImageCanvas {
    /// Columns and rows.
    #[must_use]
    pub fn size_px(&self) -> [usize; 2] {
        [camera::SIZE_PX; 2]
    }

    /// The frames: counts by rows.
    #[must_use]
    pub fn frames(&self) -> Vec<Vec<u16>> {
        let causes = Causes(&self.hidden);
        let of = |part: u32| stream(self.seed, self.family, self.index, part);
        let pixels = Pixels::draw(&mut of(PART_PIXELS), &self.world, causes);
        let electronics = Electronics::draw(&mut of(PART_ELECTRONICS), &self.world.camera, &self.world.sky_codes(), causes);
        let frame = |number: usize| {
            let mut rng = of(PART_FRAMES + number as u32);
            let light = light::light(&self.world, number, causes);
            let charge = collected(&self.world, number, &pixels, light, causes, Some(&mut rng));
            let signal = amplified(&self.world.camera, moved(&self.world.camera, charge, causes), causes);
            counts(&self.world.camera, &electronics, &signal, causes, &mut rng)
        };
        (0..self.world.frames.len()).into_par_iter().map(frame).collect()
    }
}

/// What is hidden in the recording of an index, with multiples of what is just seen, and how the data are not as declared.
fn plan(family: Family, index: u32) -> (Vec<(PixelKind, f64)>, Option<Trap>) {
    let at = index as usize;
    match family {
        Family::ImageHardNull => (Vec::new(), Some(IMAGE_TRAPS[at % IMAGE_TRAPS.len()])),
        Family::ImageLadder => {
            let multiple = PIXEL_LADDER[at / IMAGE_KINDS.len() % PIXEL_LADDER.len()];
            (vec![(IMAGE_KINDS[at % IMAGE_KINDS.len()], multiple)], None)
        }
        Family::ImageTwo => {
            let multiple = TOGETHER[at / IMAGE_PAIRS.len() % TOGETHER.len()];
            (IMAGE_PAIRS[at % IMAGE_PAIRS.len()].map(|kind| (kind, multiple)).to_vec(), None)
        }
        Family::ImageSeveral => {
            let multiple = TOGETHER[at / IMAGE_GROUPS.len() % TOGETHER.len()];
            (IMAGE_GROUPS[at % IMAGE_GROUPS.len()].map(|kind| (kind, multiple)).to_vec(), None)
        }
        _ => (Vec::new(), None),
    }
}

/// The recording of an index.
pub(super) fn concealed_images(family: Family, index: u32, seed: u64, catalog: &Catalog) -> Concealed {
    let (planned, trap) = plan(family, index);
    let of = |part: u32| stream(seed, family.number(), index, part);
    let needs = Needs {
        ground: planned.iter().find_map(|(kind, _)| kind.needs_ground()),
        exposures: planned.iter().any(|(kind, _)| kind.needs_exposures()),
        trap,
    };
    let world = ImageWorld::draw(&mut of(PART_WORLD), needs, catalog);
    let mut rng = of(PART_SIZES);
    let noiseless = (!planned.is_empty()).then(|| Noiseless::new(&world));
    let mut hidden = Vec::new();
    let mut effects = Vec::new();
    for (kind, multiple) in planned {
        let beside = (!hidden.is_empty()).then(|| Noiseless::beside(&world, &hidden));
        let (own, snr) = sized(kind, multiple, &mut rng, &world, beside.as_ref().or(noiseless.as_ref()));
        effects.push(TrueEffect {
            id: kind.id().to_owned(),
            label: kind.label().to_owned(),
            in_library: true,
            parameters: Vec::new(),
            snr,
            multiple,
            raw_rms_px: 0.0,
            survival: 1.0,
            covariates: kind.covariates().iter().map(|name| (*name).to_owned()).collect(),
            alike: Vec::new(),
            reckoned: Some(kind.reckoned()),
        });
        hidden.push(own);
    }
    for (effect, own) in effects.iter_mut().zip(&hidden) {
        effect.parameters = own.parameters(&world, Causes(&hidden));
    }
    let pair_cos = match (&hidden[..], &noiseless) {
        ([a, b], Some(noiseless)) if [a, b].iter().all(|own| own.kind.reckoned() == Reckoned::Stamps) => Some(noiseless.cosine([a, b])),
        _ => None,
    };
    let optics = &world.world.optics;
    let truth = Truth {
        format: TRUTH_FORMAT.to_owned(),
        family,
        index,
        seed,
        setup: world.world.setup.to_owned(),
        trap,
        effects,
        pair_cos,
        camera: TrueCamera { parameters: [optics.centre_px[0], optics.centre_px[1], optics.focal_px, optics.k1, optics.p1, optics.p2] },
        frames: world.frames.len(),
        stars: world.frames.iter().map(|frame| frame.stars.len()).sum(),
    };
    let lists = lists(&world);
    let images = ImageCanvas { world, hidden, seed, family: family.number(), index };
    Concealed { lists, canvas: None, images: Some(Box::new(images)), truth }
}

/// An effect at so many times what is just seen, and its signal-to-noise ratio (0 where it is reckoned in steps).
fn sized(kind: PixelKind, multiple: f64, rng: &mut impl Rng, world: &ImageWorld, noiseless: Option<&Noiseless<'_>>) -> (HiddenImage, f64) {
    let drawn = HiddenImage::draw(kind, rng, world);
    let sign = if kind.has_sign() && chance(rng, 0.5) { -1.0 } else { 1.0 };
    let at = |size: f64| HiddenImage { size, ..drawn.clone() };
    let wanted = JUST_SEEN * multiple;
    match (kind.reckoned(), noiseless) {
        (Reckoned::Steps, _) | (_, None) => {
            let noise_dn = world.pixel_variance_e2().sqrt() / world.camera.gain_e_per_dn;
            // Bits are whole.
            let size = if kind == PixelKind::LostBits { multiple.log2().max(1.0) } else { kind.step(noise_dn) * multiple };
            (at(size), 0.0)
        }
        (Reckoned::Noise, _) => (at(sign * noise_size(kind, world, wanted)), wanted),
        (_, Some(noiseless)) => {
            let most = kind.largest();
            let mut own = at(sign * drawn.size);
            let mut snr = noiseless.snr(&own);
            // Again and again, since what is large is not in proportion: a power between those that settle for what grows with the size and with its
            // square at once.
            for _ in 0..MAX_TRIALS {
                let next = (own.size.abs() * (wanted / snr.max(1e-9)).clamp(1e-4, 1e4).powf(STEP_POWER)).min(most);
                own = at(sign * next);
                snr = noiseless.snr(&own);
                if (snr / wanted - 1.0).abs() < 0.05 {
                    break;
                }
            }
            (own, snr)
        }
    }
}

/// What a recording says of itself beside its pixels.
fn lists(world: &ImageWorld) -> Lists {
    let own = &world.world;
    let line = |frame: &super::FrameTruth| FrameLine {
        time: Some(frame.time),
        temperature_c: Some(frame.temperature_c),
        velocity_km_s: own.site.is_none().then_some(frame.velocity_km_s),
        rate_deg_s: Some(frame.rate_rad_s.map(|component| component / DEG_RAD)),
        extra: frame.extra.clone(),
    };
    Lists {
        size_px: [camera::SIZE_PX; 2],
        focal_length_px: own.optics.focal_px.round(),
        site: own.site,
        exposure_s: own.exposure_s,
        zero_point_e_per_s: own.zero_point_e_per_s,
        frames: own.frames.iter().map(line).collect(),
        stars: vec![Vec::new(); own.frames.len()],
        model: own.known.clone(),
    }
}
