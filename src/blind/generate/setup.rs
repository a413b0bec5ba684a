//! The cameras of the benchmark, and the drawing of a world for one of them.

use hifitime::{Duration, Epoch};
use rand_pcg::Pcg64Mcg;

use super::random::{between, direction, normal, on_circle, pick};
use super::sky;
use super::vector::{V3, dot, east_and_north, plus, times, turned, unit};
use super::world::{FrameTruth, GeneratedStarImage, Optics, World};
use crate::catalog::Catalog;
use crate::units::{DEG_RAD, JULIAN_YEAR_DAYS, SPEED_OF_LIGHT_KM_S};

/// Frames of a camera in space keep this far from the Sun.
const SUN_DEG: f64 = 40.0;
/// Boresights of a camera on the ground stay this far from the zenith.
const NEAREST_ZENITH_DEG: f64 = 5.0;
/// Stars nearer to the horizon are not used: the air is not known there.
const LOWEST_STAR_DEG: f64 = 13.0;
/// Stars nearer to the edge are not used, so that nothing that is hidden moves one out of the frame.
const MARGIN_PX: f64 = 2.0;
/// Speed in a low orbit.
const ORBIT_KM_S: f64 = 7.6;
/// Where recordings without a time put their stars, as the program assumes.
const EPOCH_WITHOUT_TIME_YR: f64 = 2000.0;

/// A kind of camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Setup {
    /// Its name.
    pub name: &'static str,
    /// Columns and rows.
    pub size_px: [usize; 2],
    /// Focal length.
    pub focal_px: f64,
    /// Frames of a recording.
    pub frames: usize,
    /// Faintest stars, V.
    pub faintest: f64,
    /// Standard error per axis of a star half a magnitude above the limit.
    pub sigma_px: f64,
    /// On the ground: largest zenith distance of a boresight.
    pub zenith_deg: Option<f64>,
}

/// The cameras: 20° of the reference case, 11° narrow, 32° small and coarse with few frames, 47° wide on the ground.
pub const SETUPS: [Setup; 4] = [
    Setup { name: "d0", size_px: [1024, 1024], focal_px: 2900.0, frames: 40, faintest: 5.6, sigma_px: 0.05, zenith_deg: None },
    Setup { name: "narrow", size_px: [2048, 2048], focal_px: 10_635.0, frames: 40, faintest: 6.8, sigma_px: 0.05, zenith_deg: None },
    Setup { name: "few", size_px: [512, 512], focal_px: 900.0, frames: 16, faintest: 5.2, sigma_px: 0.07, zenith_deg: None },
    Setup { name: "ground", size_px: [1600, 1200], focal_px: 1850.0, frames: 36, faintest: 4.9, sigma_px: 0.05, zenith_deg: Some(48.0) },
];

/// The cameras whose frames are painted: the small one of the list, in space and on the ground.
pub const PIXEL_SETUPS: [Setup; 2] = [SETUPS[2], Setup { name: "few-ground", zenith_deg: Some(48.0), ..SETUPS[2] }];

/// What a world shall have beside its camera.
#[derive(Clone, Copy, Debug, PartialEq)]
#[allow(clippy::struct_excessive_bools, reason = "switches that have nothing to do with each other")]
pub struct Wanted {
    /// Times of the frames are told.
    pub times: bool,
    /// Light is aberrated, and the model knows it.
    pub aberration_known: bool,
    /// The model moves stars by their proper motion, and they do move.
    pub motion_known: bool,
    /// Air refracts, and the model knows it (on the ground only).
    pub refraction_known: bool,
    /// The camera turns at the same rate in all frames.
    pub constant_rate: bool,
    /// Errors grow with magnitude (else they are all the same).
    pub uneven_errors: bool,
    /// Radial distortion times this.
    pub distortion_factor: f64,
    /// The principal point is off the middle by this much more, in a random direction.
    pub centre_off_px: f64,
}

impl Wanted {
    /// A plain recording: everything is told and modelled.
    pub const PLAIN: Self = Self {
        times: true,
        aberration_known: true,
        motion_known: true,
        refraction_known: true,
        constant_rate: false,
        uneven_errors: false,
        distortion_factor: 1.0,
        centre_off_px: 0.0,
    };
}

impl Setup {
    /// A world of this camera.
    pub(super) fn draw(&self, rng: &mut Pcg64Mcg, wanted: &Wanted, catalog: &Catalog) -> World {
        let optics = self.optics(rng, wanted);
        let start = Epoch::from_gregorian_utc(2014, 1, 1, 0, 0, 0, 0)
            + Duration::from_milliseconds(between(rng, 0.0, 16.0 * JULIAN_YEAR_DAYS * 86_400_000.0).floor());
        let site = self.zenith_deg.map(|_| {
            [between(rng, -55.0, 65.0), between(rng, -180.0, 180.0), between(rng, 700.0, 1020.0).round(), between(rng, -10.0, 25.0).round()]
        });
        let frames = self.frames(rng, wanted, start, site);
        let exposure_s = 0.1 * (1 + pick(rng, 5)) as f64;
        let mut known = Vec::new();
        known.extend(wanted.motion_known.then_some("proper-motion"));
        known.extend(wanted.aberration_known.then_some("stellar-aberration"));
        known.extend((wanted.refraction_known && site.is_some()).then_some("refraction"));
        let epoch_yr = if wanted.times { sky::julian_year(frames[0].time) } else { EPOCH_WITHOUT_TIME_YR };
        let mut world = World {
            setup: self.name,
            optics,
            frames,
            images: Vec::new(),
            mean_magnitude: 0.0,
            site,
            exposure_s,
            zero_point_e_per_s: 2e6 * 10.0_f64.powf(between(rng, -0.2, 0.2)) / (exposure_s / 0.2),
            known,
            years_of_motion: epoch_yr - catalog.epoch_yr,
        };
        world.images = self.images(&world, wanted, catalog);
        world.mean_magnitude = world.images.iter().map(|image| image.magnitude).sum::<f64>() / world.images.len().max(1) as f64;
        world
    }

    fn optics(&self, rng: &mut Pcg64Mcg, wanted: &Wanted) -> Optics {
        let [width_px, height_px] = self.size_px;
        let half = width_px as f64 / 2.0;
        // Distortion of up to a pixel or two at the edge, decentring a tenth of that.
        let edge_px = |rng: &mut _, scale: f64| scale * normal(rng);
        let off = on_circle(rng).map(|share| share * wanted.centre_off_px);
        Optics {
            width_px,
            height_px,
            focal_px: self.focal_px * (1.0 + 0.003 * normal(rng)),
            centre_px: [
                (width_px as f64 - 1.0) / 2.0 + 2.0 * normal(rng) + off[0],
                (height_px as f64 - 1.0) / 2.0 + 2.0 * normal(rng) + off[1],
            ],
            k1: edge_px(rng, wanted.distortion_factor) / half.powi(3),
            p1: edge_px(rng, 0.1) / half.powi(2),
            p2: edge_px(rng, 0.1) / half.powi(2),
        }
    }

    fn frames(&self, rng: &mut Pcg64Mcg, wanted: &Wanted, start: Epoch, site: Option<[f64; 4]>) -> Vec<FrameTruth> {
        let span_h = if self.zenith_deg.is_some() { between(rng, 3.0, 8.0) } else { between(rng, 3.0, 24.0) };
        let mut hours: Vec<f64> = (0..self.frames).map(|_| between(rng, 0.0, span_h)).collect();
        hours.sort_by(f64::total_cmp);
        // Times in whole milliseconds, as a manifest has them.
        let hours: Vec<f64> = hours.into_iter().map(|hour| (hour * 3.6e6).round() / 3.6e6).collect();
        let middles: Vec<Epoch> = hours.iter().map(|hour| start + Duration::from_milliseconds((hour * 3.6e6).round())).collect();
        let mean_h = hours.iter().sum::<f64>() / hours.len() as f64;
        let (swings, phase, mean_c) = (between(rng, 1.6, 3.4), between(rng, 0.0, std::f64::consts::TAU), between(rng, -5.0, 25.0));
        let pole = direction(rng);
        let (node, along) = east_and_north(pole);
        let orbit_rate_rad_h = std::f64::consts::TAU / 1.55;
        let common_rate = direction(rng);
        let mut frames: Vec<FrameTruth> = hours
            .iter()
            .zip(&middles)
            .map(|(hour, time)| {
                // The temperature swings to and fro more than once, so that it does not follow the time.
                let temperature = mean_c + 5.0 * (swings * std::f64::consts::TAU * hour / span_h + phase).sin() + 1.0 * normal(rng);
                let rate = if wanted.constant_rate { times(common_rate, 0.1) } else { times(direction(rng), between(rng, 0.04, 0.2)) };
                let earth = sky::earth_velocity_km_s(*time).unwrap_or_default();
                let above = site.map(|[latitude, longitude, ..]| sky::zenith(*time, latitude, longitude));
                let (sin, cos) = (orbit_rate_rad_h * hour).sin_cos();
                let own = above.map_or(times(plus(times(node, cos), sin, along), ORBIT_KM_S), |(_, moving)| moving);
                let zenith = above.map(|(zenith, _)| zenith);
                let at = pointing(rng, zenith.zip(self.zenith_deg), *time);
                FrameTruth {
                    time: *time,
                    hours: hour - mean_h,
                    temperature_c: (temperature * 100.0).round() / 100.0,
                    kelvin: 0.0,
                    rate_rad_s: rate.map(|component| (component * 1e6).round() / 1e6 * DEG_RAD),
                    velocity_km_s: plus(earth, 1.0, own)
                        .map(|component| if self.zenith_deg.is_some() { component } else { (component * 1e6).round() / 1e6 }),
                    zenith,
                    rows: sky::attitude(at, between(rng, 0.0, std::f64::consts::TAU)),
                    untold: normal(rng),
                    extra: vec![
                        ("focus_position", normal(rng)),
                        ("bus_volts", 28.0 + 0.3 * normal(rng)),
                        ("sun_angle", between(rng, 40.0, 180.0)),
                    ],
                }
            })
            .collect();
        let mean_c = frames.iter().map(|frame| frame.temperature_c).sum::<f64>() / frames.len() as f64;
        for frame in &mut frames {
            frame.kelvin = frame.temperature_c - mean_c;
        }
        frames
    }

    /// The stars that fall into the frames.
    fn images(&self, world: &World, wanted: &Wanted, catalog: &Catalog) -> Vec<GeneratedStarImage> {
        let [width, height] = self.size_px.map(|length| length as f64 / 2.0);
        let widest = (width.hypot(height) * 1.02 / world.optics.focal_px).atan().cos();
        let strength = world.site.map_or(0.0, |[.., pressure, temperature]| sky::air(pressure, temperature));
        let years = if wanted.motion_known { world.years_of_motion } else { 0.0 };
        let moved: Vec<V3> = catalog
            .brighter_than(self.faintest)
            .iter()
            .map(|star| sky::moved(star.direction.xyz, star.proper_motion_rad_yr.unwrap_or_default(), years))
            .collect();
        let mut images = Vec::new();
        for (number, frame) in world.frames.iter().enumerate() {
            for (star, at) in catalog.brighter_than(self.faintest).iter().zip(&moved) {
                let below = frame.zenith.is_some_and(|zenith| dot(*at, zenith) < (LOWEST_STAR_DEG * DEG_RAD).sin());
                if below || dot(*at, frame.rows[2]) < widest {
                    continue;
                }
                let mut light = *at;
                if wanted.aberration_known {
                    light = unit(plus(light, 1.0, relativistic(light, frame.velocity_km_s)));
                }
                if let (true, Some(zenith)) = (wanted.refraction_known, frame.zenith) {
                    light = unit(plus(light, 1.0, sky::refraction(light, zenith, strength)));
                }
                let lands = world.optics.place(turned(&frame.rows, light));
                if !lands.is_some_and(|place| world.optics.holds(place, MARGIN_PX)) {
                    continue;
                }
                let photons = 10.0_f64.powf(0.4 * (star.magnitude - self.faintest + 0.5));
                images.push(GeneratedStarImage {
                    frame: number,
                    hip: star.hip,
                    direction: light,
                    motion_rad_yr: star.proper_motion_rad_yr.unwrap_or_default(),
                    magnitude: star.magnitude,
                    colour: star.colour.map_or(0.0, |colour| colour - 0.6),
                    sigma_px: self.sigma_px * if wanted.uneven_errors { (0.3 + 0.7 * photons).sqrt() } else { 1.0 },
                    flux_e: world.zero_point_e_per_s * 10.0_f64.powf(-0.4 * star.magnitude) * world.exposure_s,
                });
            }
        }
        images
    }
}

/// Aberration to second order in v/c.
fn relativistic(at: V3, velocity_km_s: V3) -> V3 {
    let beta = times(velocity_km_s, 1.0 / SPEED_OF_LIGHT_KM_S);
    let along = dot(at, beta);
    let first = plus(beta, -along, at);
    // −½β²·d + ½(d·β)β − (d·β)β + (d·β)²·d: the second order of the addition of velocities, the part across d.
    plus(first, -along / 2.0, first)
}

/// A boresight: away from the Sun, or up in the sky.
fn pointing(rng: &mut Pcg64Mcg, zenith: Option<(V3, f64)>, time: Epoch) -> V3 {
    if let Some((up, farthest_deg)) = zenith {
        let [nearest, farthest] = [NEAREST_ZENITH_DEG, farthest_deg].map(|angle| (angle * DEG_RAD).cos());
        let cosine = between(rng, farthest, nearest);
        let (east, north) = east_and_north(up);
        let (sin, cos) = between(rng, 0.0, std::f64::consts::TAU).sin_cos();
        let across = plus(times(east, sin), cos, north);
        return unit(plus(times(up, cosine), (1.0 - cosine * cosine).sqrt(), across));
    }
    let sun = sky::sun(time);
    loop {
        let at = direction(rng);
        if dot(at, sun) < (SUN_DEG * DEG_RAD).cos() && at[2].abs() < 0.999_999 {
            return at;
        }
    }
}
