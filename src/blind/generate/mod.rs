//! The generator of concealed recordings: star lists, and frames in which the stars of such lists are painted.
//!
//! It stands apart from the program it tests: sky, camera and every displacement are written anew here from the equations, and of the
//! library it knows the catalogue, random numbers and units alone (a test reads its imports). Where the two agree, they agree about physics;
//! what both have wrong is the equation itself.

mod displacements;
mod family;
pub mod images;
mod kind;
mod limit;
mod off_library;
mod paint;
mod random;
mod setup;
mod shape;
mod sky;
mod truth;
mod vector;
mod world;

use hifitime::Epoch;
use rand::Rng;
use rand_pcg::Pcg64Mcg;

pub use family::{FAMILIES, Family, IMAGE_TRAPS, LADDER, PIXEL_LADDER, PIXEL_STRENGTHS, STRENGTHS, TRAPS, Trap};
pub use kind::{ABSORBED, Hidden, Kind, LIBRARY, OFF_LIBRARY, TrueParameter};
pub use limit::{Fisher, Signal};
pub use paint::{Canvas, PaintedStar, centre_sigma_px};
pub use setup::{PIXEL_SETUPS, SETUPS, Setup, Wanted};
pub use truth::{Alike, TRUTH_FORMAT, TrueCamera, TrueEffect, Truth};
pub use world::{DetectorPlace, FrameTruth, GeneratedStarImage, Optics, World};

use crate::catalog::Catalog;
use crate::units::DEG_RAD;
use family::Plan;
use random::{between, chance, heavy, normal, pick, stream};

/// What a recording says of a frame.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameLine {
    /// Middle of the exposure.
    pub time: Option<Epoch>,
    /// Temperature.
    pub temperature_c: Option<f64>,
    /// Velocity.
    pub velocity_km_s: Option<[f64; 3]>,
    /// Rate.
    pub rate_deg_s: Option<[f64; 3]>,
    /// Other numbers.
    pub extra: Vec<(&'static str, f64)>,
}

/// What a recording says of a star image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StarLine {
    /// Measured column.
    pub x_px: f64,
    /// Measured row.
    pub y_px: f64,
    /// Declared standard error per axis.
    pub sigma_px: f64,
    /// Electrons.
    pub flux_e: f64,
    /// Star.
    pub hip: u32,
}

/// A recording: all that a diagnosis sees.
#[derive(Clone, Debug, PartialEq)]
pub struct Lists {
    /// Columns and rows.
    pub size_px: [usize; 2],
    /// Declared focal length.
    pub focal_length_px: f64,
    /// Latitude, longitude, pressure, temperature of the site.
    pub site: Option<[f64; 4]>,
    /// Exposure.
    pub exposure_s: f64,
    /// Electrons per second of a star of V = 0.
    pub zero_point_e_per_s: f64,
    /// Frames.
    pub frames: Vec<FrameLine>,
    /// Stars by frame.
    pub stars: Vec<Vec<StarLine>>,
    /// The effects that the model to be tested contains.
    pub model: Vec<&'static str>,
}

/// A recording and what is true of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Concealed {
    /// The recording as star lists.
    pub lists: Lists,
    /// In the families of pixels: the frames of the same stars, to be painted.
    pub canvas: Option<Canvas>,
    /// In the families of what is hidden in pixels: what the frames are painted from.
    pub images: Option<Box<images::ImageCanvas>>,
    /// The truth.
    pub truth: Truth,
}

/// Parts of a recording's random numbers.
const PART_PLAN: u32 = 0;
const PART_NOISE: u32 = 1;
/// Worlds that are tried; each takes a part of its own from here on.
const PART_WORLDS: u32 = 16;
/// Worlds tried until one shows the effect.
const TRIES: u32 = 8;
/// What survives of an effect at least, in a world that shows it.
const MIN_SURVIVAL: f64 = 0.02;
/// Larger displacements are not hidden: they would be seen by eye.
const LARGEST_RMS_PX: f64 = 3.0;
/// Displacement (rms) of what is taken up, and the most that may be left of it. What the principal point takes up must stay small: to stand
/// in for half a pixel it moves by 40 px, and the square of that way times k1 can be seen, which the linear limit does not know.
const ABSORBED_RMS_PX: f64 = 0.1;
const ABSORBED_SNR: f64 = 0.5;

/// No camera at the Earth moves faster: 30.3 km/s of the Earth and 7.8 km/s of a low orbit. Where that is too slow to show so well, less shows.
const FASTEST_KM_S: f64 = 40.0;

/// Relative standard error of a measured flux.
const FLUX_ERROR: f64 = 0.02;

/// The recording of an index.
#[must_use]
pub fn concealed(family: Family, index: u32, seed: u64, catalog: &Catalog) -> Concealed {
    if family.is_of_images() {
        return images::concealed_images(family, index, seed, catalog);
    }
    let mut rng = stream(seed, family.number(), index, PART_PLAN);
    let plan = family.plan(index, || pair(&mut rng));
    let mut attempt = 0;
    let (world, whole, wanted, hidden, mut rng) = loop {
        let mut rng = stream(seed, family.number(), index, PART_WORLDS + attempt);
        let painted = family.of_lists().is_some();
        let setup = choose(&mut rng, &plan, index, attempt, if painted { &PIXEL_SETUPS } else { &SETUPS });
        let wanted = wanted(&mut rng, &plan);
        let mut world = setup.draw(&mut rng, &wanted, catalog);
        let whole = painted.then(|| {
            paint::expose(&mut world, setup.faintest, setup.sigma_px);
            let lone = paint::without_blends(&world);
            std::mem::replace(&mut world, lone)
        });
        let (hidden, shown) = sized(&mut rng, &plan, &world);
        attempt += 1;
        if shown || attempt == TRIES {
            break (world, whole, wanted, hidden, rng);
        }
    };
    let mut noise = stream(seed, family.number(), index, PART_NOISE);
    let lists = lists(&mut rng, &mut noise, &plan, &world, &wanted, &hidden);
    let truth = Truth::new(family, index, seed, &world, &hidden, plan.trap, wanted.times);
    let canvas = whole.map(|whole| Canvas::new(family, index, seed, &whole, &hidden));
    Concealed { lists, canvas, images: None, truth }
}

/// A world of a camera, with nothing hidden in it: for looking at what can be seen there.
#[must_use]
pub fn world(setup: &Setup, wanted: &Wanted, seed: u64, catalog: &Catalog) -> World {
    setup.draw(&mut stream(seed, 0, 0, PART_WORLDS), wanted, catalog)
}

/// Two effects that can be there at once, and their signal-to-noise ratios.
fn pair(rng: &mut impl Rng) -> [(Kind, f64); 2] {
    loop {
        let [a, b] = [LIBRARY[pick(rng, LIBRARY.len())], LIBRARY[pick(rng, LIBRARY.len())]];
        let clash = |one: Kind, other: Kind| {
            (one.needs_ground() && other.needs_space()) || (one == Kind::AberrationOfUnknownVelocity && other == Kind::FocalLengthDrift)
        };
        if a.id() != b.id() && !clash(a, b) && !clash(b, a) {
            return [a, b].map(|kind| (kind, between(rng, 7.0, 15.0)));
        }
    }
}

impl Plan {
    fn involves(&self, property: impl Fn(Kind) -> bool) -> bool {
        self.hidden.iter().map(|(kind, _)| *kind).chain(self.beside).any(property)
    }
}

/// One of the cameras; the first of them is the reference, the last alone stands on the ground.
fn choose(rng: &mut impl Rng, plan: &Plan, index: u32, attempt: u32, setups: &'static [Setup]) -> &'static Setup {
    let (reference, ground) = (&setups[0], &setups[setups.len() - 1]);
    if plan.involves(Kind::needs_ground) {
        ground
    } else if attempt + 1 == TRIES {
        reference
    } else if plan.involves(Kind::needs_space) {
        &setups[pick(rng, setups.len() - 1)]
    } else if plan.hidden.is_empty() {
        &setups[index as usize % setups.len()]
    } else {
        &setups[pick(rng, setups.len())]
    }
}

fn wanted(rng: &mut impl Rng, plan: &Plan) -> Wanted {
    let hides = |kind| plan.involves(|one| one == kind);
    let without_times = hides(Kind::AberrationOfUnknownVelocity);
    let aberrates = chance(rng, 0.5);
    let refracts = chance(rng, 0.7);
    Wanted {
        times: !without_times,
        aberration_known: aberrates && !hides(Kind::Aberration) && !without_times,
        motion_known: !hides(Kind::ProperMotionLeftOut),
        refraction_known: (refracts || hides(Kind::ChromaticRefraction)) && !hides(Kind::Refraction) && !hides(Kind::TimeTag),
        constant_rate: plan.constant_rate,
        uneven_errors: chance(rng, 0.5),
        distortion_factor: if plan.trap == Some(Trap::DistortionTripled) { 3.0 } else { 1.0 },
        centre_off_px: if plan.trap == Some(Trap::CentreOff) { 5.0 } else { 0.0 },
    }
}

/// What is hidden, at its size; and whether this world shows it well enough.
fn sized(rng: &mut impl Rng, plan: &Plan, world: &World) -> (Vec<Hidden>, bool) {
    const PROBE: f64 = 1e-6;
    const PROBE_RMS_PX: f64 = 0.1;
    let fisher = Fisher::new(world);
    let mut shown = true;
    let hidden = plan.hidden.iter().map(|(kind, snr)| {
        let drawn = Hidden::draw(*kind, rng, world);
        let sign =
            if matches!(kind, Kind::Aberration | Kind::Refraction | Kind::ProperMotionLeftOut) || chance(rng, 0.5) { 1.0 } else { -1.0 };
        let probe = fisher.signal(&drawn.scaled(PROBE));
        let probe = drawn.scaled(sign * PROBE * PROBE_RMS_PX / probe.raw_rms_px.max(f64::MIN_POSITIVE));
        let signal = fisher.signal(&probe);
        if ABSORBED.contains(kind) {
            let full = probe.scaled(ABSORBED_RMS_PX / signal.raw_rms_px);
            return full.scaled((ABSORBED_SNR / fisher.signal(&full).snr).min(1.0));
        }
        if *snr == 0.0 {
            let natural = if *kind == Kind::Refraction { world.site.map_or(1.0, |[.., p, t]| sky::air(p, t)) } else { 1.0 };
            return drawn.scaled(natural);
        }
        // Twice, since what is large is not quite in proportion.
        let first = probe.scaled(snr / signal.snr);
        let found = fisher.signal(&first);
        shown &= found.survival >= MIN_SURVIVAL && found.raw_rms_px <= LARGEST_RMS_PX;
        let whole = first.scaled(snr / found.snr);
        match speed_km_s(&whole).filter(|speed| *speed > FASTEST_KM_S) {
            Some(speed) => {
                shown = false;
                whole.scaled(FASTEST_KM_S / speed)
            }
            None => whole,
        }
    });
    let hidden: Vec<Hidden> = hidden.collect();
    (hidden, shown)
}

/// The speed of a velocity that nobody tells.
fn speed_km_s(hidden: &Hidden) -> Option<f64> {
    let square: f64 = hidden.numbers.iter().map(|component| component * component).sum();
    (hidden.kind == Kind::AberrationOfUnknownVelocity).then(|| hidden.size.abs() * square.sqrt())
}

/// The recording that the world leaves behind.
fn lists(rng: &mut Pcg64Mcg, noise: &mut Pcg64Mcg, plan: &Plan, world: &World, wanted: &Wanted, hidden: &[Hidden]) -> Lists {
    let size_of = |kind| hidden.iter().find(|one| one.kind == kind).map(|one| one.size);
    let temperature = chance(rng, 0.75) || plan.involves(Kind::needs_temperature);
    let rates = chance(rng, 0.75) || plan.involves(|kind| kind == Kind::RollingShutter);
    let extra = chance(rng, 0.75) || plan.involves(|kind| kind == Kind::FocusStepTrefoil);
    let velocity = match size_of(Kind::Aberration) {
        Some(size) => Some(size),
        None => (wanted.aberration_known && world.site.is_none()).then_some(1.0),
    };
    let mut frames: Vec<FrameLine> = world
        .frames
        .iter()
        .map(|frame| FrameLine {
            time: wanted.times.then_some(frame.time),
            temperature_c: temperature.then_some(frame.temperature_c),
            velocity_km_s: velocity.map(|size| frame.velocity_km_s.map(|component| component * size)),
            rate_deg_s: rates.then(|| frame.rate_rad_s.map(|component| component / DEG_RAD)),
            extra: if extra { frame.extra.clone() } else { Vec::new() },
        })
        .collect();
    if plan.trap == Some(Trap::TelemetryShuffled) {
        shuffle(noise, &mut frames);
    }
    let site = world.site.map(|[latitude, longitude, pressure, temperature]| {
        let pressure = size_of(Kind::Refraction).map_or(pressure, |strength| strength * pressure / sky::air(pressure, temperature));
        [latitude, longitude, pressure, temperature]
    });
    Lists {
        size_px: [world.optics.width_px, world.optics.height_px],
        focal_length_px: (world.optics.focal_px * (1.0 + 0.003 * normal(rng))).round(),
        site,
        exposure_s: world.exposure_s,
        zero_point_e_per_s: world.zero_point_e_per_s,
        frames,
        stars: measured(noise, plan.trap, world, hidden),
        model: world.known.clone(),
    }
}

/// Exchanges temperature, rate and other numbers among the frames; times and velocities stay, the model lives on them.
fn shuffle(rng: &mut Pcg64Mcg, frames: &mut [FrameLine]) {
    for last in (1..frames.len()).rev() {
        let other = pick(rng, last + 1);
        if other == last {
            continue;
        }
        let (before, after) = frames.split_at_mut(last);
        std::mem::swap(&mut before[other].temperature_c, &mut after[0].temperature_c);
        std::mem::swap(&mut before[other].rate_deg_s, &mut after[0].rate_deg_s);
        std::mem::swap(&mut before[other].extra, &mut after[0].extra);
    }
}

/// Every star image with its error and its name.
fn measured(rng: &mut Pcg64Mcg, trap: Option<Trap>, world: &World, hidden: &[Hidden]) -> Vec<Vec<StarLine>> {
    let mut stars: Vec<Vec<StarLine>> = vec![Vec::new(); world.frames.len()];
    for (image, at) in world.images.iter().zip(world.predict(hidden)) {
        let error = |rng: &mut Pcg64Mcg| if trap == Some(Trap::HeavyTails) { heavy(rng) } else { normal(rng) };
        let point = [at[0] + image.sigma_px * error(rng), at[1] + image.sigma_px * error(rng)];
        let [x, y] = [point[0] - world.optics.centre_px[0], point[1] - world.optics.centre_px[1]];
        if !world.optics.holds(world.optics.at([x, y]), 0.0) {
            continue;
        }
        let declared = match trap {
            Some(Trap::ErrorsHalved) => 0.5,
            Some(Trap::ErrorsDoubled) => 2.0,
            Some(Trap::BrightErrors) => 0.25 + 0.75 / (1.0 + 10.0_f64.powf(0.8 * (world.mean_magnitude - 1.0 - image.magnitude))),
            _ => 1.0,
        };
        let flux_e = image.flux_e * (1.0 + FLUX_ERROR * normal(rng));
        let line = StarLine { x_px: point[0], y_px: point[1], sigma_px: image.sigma_px * declared, flux_e, hip: image.hip };
        stars[image.frame].push(line);
    }
    let share = match trap {
        Some(Trap::Misidentified10) => 0.1,
        Some(Trap::Misidentified30) => 0.3,
        _ => return stars,
    };
    for list in &mut stars {
        let wrong: Vec<usize> = (0..list.len()).filter(|_| chance(rng, share)).collect();
        // Names go round, so that no star is there twice.
        let names: Vec<u32> = wrong.iter().map(|star| list[*star].hip).collect();
        for (place, star) in wrong.iter().enumerate() {
            list[*star].hip = names[(place + 1) % names.len()];
        }
    }
    stars
}
