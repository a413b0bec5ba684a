//! The cameras whose frames are painted with effects in pixels, drawn anew for every recording, and the sky they look at.

use rand_pcg::Pcg64Mcg;

use super::super::family::Trap;
use super::super::random::{between, chance, normal, on_circle, pick};
use super::super::setup::{Setup, Wanted};
use super::super::vector::{dot, east_and_north, plus, turned, unit};
use super::super::world::World;
use super::spread::PaintedProfile;
use crate::catalog::Catalog;

/// Columns and rows.
pub(super) const SIZE_PX: usize = 512;
/// Star images in a frame, on average, down to the faintest of the list.
const STARS: f64 = 50.0;
/// Stars so much fainter than the faintest of the list are painted too, mag: no camera sees a sky that ends.
const FAINTER_MAG: f64 = 0.6;
/// No star beyond this is painted, V: the catalogue is not complete there.
const LAST_MAG: f64 = 8.5;
/// Scatter of the sky's slope from frame to frame, of its level, over half a frame.
pub(super) const SLOPE_SHARE: f64 = 0.02;
/// Scatter of the catalogue's magnitudes: of every star, and of the variable share of them.
const CATALOGUE_MAG: f64 = 0.012;
const VARIABLE_SHARE: f64 = 0.03;
const VARIABLE_MAG: f64 = 0.06;

/// Detector and image of one recording.
#[derive(Clone, Debug, PartialEq)]
pub struct ImageCamera {
    /// Electrons per count, as declared.
    pub gain_e_per_dn: f64,
    /// Counts of no light.
    pub bias_dn: f64,
    /// Read noise, electrons, as declared.
    pub read_noise_e: f64,
    /// Bits of the converter: its last count is that of a full pixel.
    pub bits: u32,
    /// The star image without defocus.
    pub profile: PaintedProfile,
    /// Radius of the geometric blur in best focus of the recording, px; its sign says on which side.
    pub blur_px: f64,
    /// Coma that is the same all over the field, along columns and rows, px: c of `spread::coma`.
    pub tail_px: [f64; 2],
}

impl ImageCamera {
    /// The count of a full pixel.
    #[must_use]
    pub fn full_dn(&self) -> f64 {
        f64::from((1_u32 << self.bits) - 1)
    }

    /// Variance of a pixel without light, e².
    pub(super) fn quiet_e2(&self) -> f64 {
        self.read_noise_e.powi(2) + self.gain_e_per_dn.powi(2) / 12.0
    }

    /// Electrons of a full pixel.
    pub(super) fn full_e(&self) -> f64 {
        (self.full_dn() - self.bias_dn) * self.gain_e_per_dn
    }
}

/// A star in a frame, before anything is hidden.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SkyStar {
    /// Catalogue number.
    pub hip: u32,
    /// Column of its centre.
    pub x_px: f64,
    /// Row of its centre.
    pub y_px: f64,
    /// Electrons in the frame's declared exposure.
    pub electrons: f64,
    /// B − V less 0.6; zero where unknown.
    pub colour: f64,
    /// Air mass; 1 in space.
    pub airmass: f64,
    /// Whether it is one of the catalogue's and not the companion of a blend.
    pub is_catalogued: bool,
}

/// What a frame has of its own.
#[derive(Clone, Debug, PartialEq)]
pub struct Conditions {
    /// Declared exposure, s.
    pub exposure_s: f64,
    /// Sky, electrons per pixel, and its change over half the frame in columns and rows.
    pub sky_e: [f64; 3],
    /// Temperature less the mean, K.
    pub kelvin: f64,
    /// Time from the mean, h.
    pub hours: f64,
    /// Turning about camera axes, rad/s.
    pub rate_rad_s: [f64; 3],
    /// Its stars.
    pub stars: Vec<SkyStar>,
}

/// A recording before anything is hidden.
#[derive(Clone, Debug, PartialEq)]
pub struct ImageWorld {
    /// Camera geometry and directions.
    pub world: World,
    /// Detector and star image.
    pub camera: ImageCamera,
    /// The frames.
    pub frames: Vec<Conditions>,
    /// Standard error of a magnitude of the catalogue.
    pub catalogue_mag: f64,
}

/// What a recording is to have.
#[derive(Clone, Copy, Debug)]
pub(super) struct Needs {
    /// Air above the camera; `None`: by chance.
    pub(super) ground: Option<bool>,
    pub(super) exposures: bool,
    pub(super) trap: Option<Trap>,
}

/// A setup of drawn focal length whose faintest star is chosen for the number of stars in a frame.
fn setup(rng: &mut Pcg64Mcg, needs: Needs, catalog: &Catalog) -> Setup {
    let focal_px = between(rng, 750.0, 1400.0).round();
    let half = SIZE_PX as f64 / 2.0 / focal_px;
    let share = (half * half / (1.0 + half * half)).asin() / std::f64::consts::PI;
    let wanted = STARS / share;
    let (mut low, mut high) = (3.0_f64, LAST_MAG - FAINTER_MAG);
    for _ in 0..30 {
        let middle = 0.5 * (low + high);
        if (catalog.brighter_than(middle).len() as f64) < wanted { low = middle } else { high = middle }
    }
    // Where there is no air there are no clouds.
    let ground = needs.ground.unwrap_or_else(|| chance(rng, 0.5)) || needs.trap == Some(Trap::Clouds);
    let frames = if needs.trap == Some(Trap::FewFrames) { 4 } else { 12 + pick(rng, 5) };
    Setup {
        name: if ground { "image-ground" } else { "image-space" },
        size_px: [SIZE_PX; 2],
        focal_px,
        frames,
        faintest: (low * 100.0).round() / 100.0 + FAINTER_MAG,
        sigma_px: 0.05,
        zenith_deg: ground.then_some(62.0),
    }
}

fn detector(rng: &mut Pcg64Mcg, brightest_peak_e: f64, trap: Option<Trap>) -> ImageCamera {
    let bits = if chance(rng, 0.5) { 12 } else { 14 };
    let bias_dn = if bits == 12 { between(rng, 60.0, 120.0).round() } else { between(rng, 200.0, 500.0).round() };
    let gain = brightest_peak_e / (f64::from(1_u32 << bits) - bias_dn);
    let sigma_px = between(rng, 0.6, 1.2);
    let [cos, sin] = on_circle(rng);
    let [core, wings, beta, ellipticity] = match trap {
        // A turbulent or scattering lens: Moffat throughout.
        Some(Trap::WingedImages) => [0.0, 1.1, between(rng, 2.2, 3.0), 0.02],
        Some(Trap::ElongatedImages) => [0.92, 2.0, 3.0, between(rng, 0.15, 0.3)],
        _ => [between(rng, 0.9, 0.97), between(rng, 1.6, 2.4), 3.0, between(rng, 0.0, 0.04)],
    };
    ImageCamera {
        // Declared with three digits, as data sheets are.
        gain_e_per_dn: (gain * 1000.0).round().max(100.0) / 1000.0,
        bias_dn,
        read_noise_e: (between(rng, 2.5, 9.0) * 10.0).round() / 10.0,
        bits,
        profile: PaintedProfile { sigma_px, core, wings, beta, axes: [ellipticity * cos, ellipticity * sin] },
        blur_px: between(rng, 0.4, 0.9) * if chance(rng, 0.5) { 1.0 } else { -1.0 },
        tail_px: if trap == Some(Trap::LopsidedImages) { lopsided(rng, sigma_px) } else { [0.0; 2] },
    }
}

/// Coma of a lens whose elements are not centred: the same all over the field (Thompson, JOSA A 22, 1389 (2005)).
fn lopsided(rng: &mut Pcg64Mcg, sigma_px: f64) -> [f64; 2] {
    let length = between(rng, 0.6, 1.0) * sigma_px;
    on_circle(rng).map(|along| length * along)
}

impl ImageWorld {
    pub(super) fn draw(rng: &mut Pcg64Mcg, needs: Needs, catalog: &Catalog) -> Self {
        let setup = setup(rng, needs, catalog);
        let mut world = setup.draw(rng, &Wanted::PLAIN, catalog);
        let faintest_listed = setup.faintest - FAINTER_MAG;
        // A star of the faintest listed has this signal-to-noise ratio above sky and read noise of about twelve pixels.
        let base_sky_e = between(rng, 30.0, 200.0);
        let snr = between(rng, 12.0, 25.0);
        let faint_e = 0.5 * snr * (snr + (snr * snr + 4.0 * 12.0 * (base_sky_e + 30.0)).sqrt());
        let full_mag = between(rng, 3.2, 4.5);
        // The peak holds about a seventh of the light.
        let camera = detector(rng, 0.14 * faint_e * 10.0_f64.powf(0.4 * full_mag), needs.trap);
        world.exposure_s = (between(rng, 0.2, 2.0) * 20.0).round() / 20.0;
        world.zero_point_e_per_s = faint_e * 10.0_f64.powf(0.4 * faintest_listed) / world.exposure_s;
        let mut frames = Vec::new();
        for (number, frame) in world.frames.iter().enumerate() {
            let exposure_s = if needs.exposures { world.exposure_s * f64::from(1_u32 << (number % 3)) } else { world.exposure_s };
            let level = base_sky_e * (0.5 * normal(rng)).exp() * exposure_s / world.exposure_s;
            let slope = [SLOPE_SHARE * normal(rng) * level, SLOPE_SHARE * normal(rng) * level];
            frames.push(Conditions {
                exposure_s,
                sky_e: [level, slope[0], slope[1]],
                kelvin: frame.kelvin,
                hours: frame.hours,
                rate_rad_s: frame.rate_rad_s,
                stars: Vec::new(),
            });
        }
        let mut own = Self { world, camera, frames, catalogue_mag: CATALOGUE_MAG };
        own.shine(rng, needs.trap);
        own
    }

    /// The codes of the sky of all frames, and how often each comes.
    pub(super) fn sky_codes(&self) -> Vec<(u32, f64)> {
        const SIGMAS: f64 = 3.0;
        let (camera, last) = (&self.camera, f64::from((1_u32 << self.camera.bits) - 1));
        let of = |frame: &Conditions| {
            let level_dn = camera.bias_dn + frame.sky_e[0] / camera.gain_e_per_dn;
            let sigma_dn = (frame.sky_e[0] + camera.quiet_e2()).sqrt() / camera.gain_e_per_dn;
            let [low, high] = [-SIGMAS, SIGMAS].map(|sigmas| (level_dn + sigmas * sigma_dn).clamp(0.0, last) as u32);
            (low..=high).map(move |code| (code, (-0.5 * ((f64::from(code) - level_dn) / sigma_dn).powi(2)).exp() / sigma_dn))
        };
        self.frames.iter().flat_map(of).collect()
    }

    /// Mean of the skies of the frames, electrons per pixel.
    pub(super) fn mean_sky_e(&self) -> f64 {
        self.frames.iter().map(|frame| frame.sky_e[0]).sum::<f64>() / self.frames.len() as f64
    }

    /// Variance of a sky pixel, the mean of the frames, e².
    pub(super) fn pixel_variance_e2(&self) -> f64 {
        self.mean_sky_e() + self.camera.quiet_e2()
    }

    /// Places and brightness of the stars: the catalogue's, as wrong as it is.
    fn shine(&mut self, rng: &mut Pcg64Mcg, trap: Option<Trap>) {
        let mut wrong: std::collections::BTreeMap<u32, (f64, [f64; 4])> = std::collections::BTreeMap::new();
        let waves: Vec<Waves> = self.frames.iter().map(|_| Waves::draw(rng)).collect();
        let places = self.world.predict(&[]);
        for (image, place) in self.world.images.iter().zip(places) {
            let (off_mag, companion) = *wrong.entry(image.hip).or_insert_with(|| {
                let variable = chance(rng, VARIABLE_SHARE);
                let far_off = chance(rng, 0.25) && trap == Some(Trap::CatalogueMagnitudes);
                let sign = if chance(rng, 0.5) { 1.0 } else { -1.0 };
                let more = if far_off { sign * between(rng, 0.1, 0.3) } else { 0.0 };
                let [cos, sin] = on_circle(rng);
                let apart_px = between(rng, 1.2, 4.0);
                let share = between(rng, 0.1, 0.7);
                let is_blend = chance(rng, 1.0 / 3.0);
                let mag = more + CATALOGUE_MAG * normal(rng) + if variable { VARIABLE_MAG * normal(rng) } else { 0.0 };
                (mag, [cos * apart_px, sin * apart_px, share, f64::from(u8::from(is_blend))])
            });
            let frame = &mut self.frames[image.frame];
            let wave = &waves[image.frame];
            let (half, [u, v]) = (SIZE_PX as f64 / 2.0, place.map(|at| at / (SIZE_PX as f64 / 2.0) - 1.0));
            let cloud_mag = if trap == Some(Trap::Clouds) { wave.loss_mag(u, v) } else { 0.0 };
            let moved = if trap == Some(Trap::Turbulence) { wave.motion_px(u, v) } else { [0.0; 2] };
            let electrons =
                self.world.zero_point_e_per_s * frame.exposure_s * 10.0_f64.powf(-0.4 * (image.magnitude + off_mag + cloud_mag));
            let airmass = self.world.frames[image.frame].zenith.map_or(1.0, |zenith| dot(zenith, image.direction).max(0.1).recip());
            let star = SkyStar {
                hip: image.hip,
                x_px: place[0] + moved[0],
                y_px: place[1] + moved[1],
                electrons,
                colour: image.colour,
                airmass,
                is_catalogued: true,
            };
            frame.stars.push(star);
            if trap == Some(Trap::BlendedField) && companion[3] > 0.0 {
                // It stands still in the sky: east and north, and turns with the camera.
                let (east, north) = east_and_north(image.direction);
                let step = self.world.optics.focal_px.recip();
                let beside = unit(plus(plus(image.direction, companion[0] * step, east), companion[1] * step, north));
                let Some(at) = self.world.optics.place(turned(&self.world.frames[image.frame].rows, beside)) else { continue };
                if (at.column - half).abs() < half && (at.row - half).abs() < half {
                    let electrons = electrons * companion[2];
                    frame.stars.push(SkyStar { x_px: at.column, y_px: at.row, electrons, is_catalogued: false, ..star });
                }
            }
        }
    }
}

/// Smooth random fields of one frame: a few plane waves.
struct Waves {
    /// Wave numbers per half frame, phase, amplitudes.
    all: Vec<[f64; 6]>,
    grey_mag: f64,
}

impl Waves {
    fn draw(rng: &mut Pcg64Mcg) -> Self {
        let all = (0..4)
            .map(|_| {
                let [cos, sin] = on_circle(rng);
                let number = between(rng, 0.4, 3.0);
                [number * cos, number * sin, between(rng, 0.0, std::f64::consts::TAU), normal(rng), normal(rng), normal(rng)]
            })
            .collect();
        Self { all, grey_mag: between(rng, 0.0, 0.4) }
    }

    fn sum(&self, u: f64, v: f64, which: usize) -> f64 {
        self.all.iter().map(|wave| wave[which] * (wave[0] * u + wave[1] * v + wave[2]).sin()).sum::<f64>() / 2.0_f64.sqrt()
    }

    /// Grey loss of a cloud: the frame's own, and what varies over it.
    fn loss_mag(&self, u: f64, v: f64) -> f64 {
        (self.grey_mag * (1.0 + 0.35 * self.sum(u, v, 3))).max(0.0)
    }

    /// Motion that neighbours share (turbulence), px.
    fn motion_px(&self, u: f64, v: f64) -> [f64; 2] {
        [0.08 * self.sum(u, v, 4), 0.08 * self.sum(u, v, 5)]
    }
}
