//! Track of a star's image in the course of an exposure.
//!
//! A star's place is followed through the whole chain at every moment: sky, attitude, optics, shutter. The exposure is summed up at
//! Gauss–Legendre nodes in time. The point spread is smooth, so the sum converges faster than any power of their number; as many are taken as
//! bring a trail of a Gaussian, straight or bent, within 1e-6 of the star's light in every pixel.
//!
//! **Rolling shutter.** Each row is exposed for the same time, but its middle is t·(y − y_mid) after that of the middle row. At the time u from
//! a row's own middle the star lights the row y where the equation y = y(u + t·(y − y_mid)) holds; rows beside it see it shifted in
//! proportion to their distance ([`Sample::shear`]). Neglected: motion so fast that a star overtakes the rows as they are exposed.

use super::motion::later;
use super::quadrature::gauss_legendre;
use super::{Exposure, Scene, TrueStarImage};
use crate::catalog::{Catalog, Star};
use crate::coordinates::{Direction, PixelPoint};
use crate::effects::ids;
use crate::effects::{Context, Observation, StarImage as ImageState, StarState};
use crate::parallel;

/// Trails longer than this (in widths of the point spread) are summed up piece by piece.
const LONGEST_PIECE: f64 = 40.0;

/// Rows on each side of the star between which its motion is taken as even.
const SHEAR_ROWS: f64 = 12.0;

/// Less shear than this moves no light by a millionth of a pixel.
const MIN_SHEAR: f64 = 5e-8;

/// A moment of an exposure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Time from the middle of the row's exposure.
    pub time_s: f64,
    /// Share of the exposure that it stands for.
    pub weight: f64,
    /// Where the star's light falls.
    pub place: PixelPoint,
    /// How far the place moves from one row to the next, px per row.
    pub shear: [f64; 2],
}

/// One star during one exposure.
#[derive(Clone, Debug, PartialEq)]
pub struct StarTrack {
    /// Catalogue number.
    pub hip: u32,
    /// V magnitude.
    pub magnitude: f64,
    /// B − V, where known.
    pub colour: Option<f64>,
    /// Temperature of the optics minus its mean over the exposures, K; 0 where it is not known.
    pub temperature_offset_k: f64,
    /// Electrons that the star sends during the whole exposure.
    pub electrons: f64,
    /// Where a camera of this projection, focal length and principal point would show the catalogue's direction at the middle of the exposure,
    /// if nothing displaced it: neither sky nor distortion nor detector. `None` where it would not, and for what is no star.
    pub ideal: Option<PixelPoint>,
    /// Place at the start, the middle and the end of the exposure of the row that it lights; `None` where it has none.
    pub start_mid_end: [Option<PixelPoint>; 3],
    /// The moments at which it lights the frame, in order of time; their weights add up to 1 where it does so all the time.
    pub samples: Vec<Sample>,
    /// Covariance of motion that is faster than the exposure: xx, xy, yy, px².
    pub blur_px2: [f64; 3],
}

impl StarTrack {
    /// Mean place of the light, over the time that it lights the frame.
    #[must_use]
    pub fn mean(&self) -> PixelPoint {
        let weight: f64 = self.samples.iter().map(|sample| sample.weight).sum();
        let of = |place: fn(&Sample) -> f64| self.samples.iter().map(|sample| sample.weight * place(sample)).sum::<f64>() / weight;
        PixelPoint { x_px: of(|sample| sample.place.x_px), y_px: of(|sample| sample.place.y_px) }
    }
}

/// How many nodes a trail needs, by its length in widths of the point spread and the oscillations on the way: found by comparison with dense
/// sums for σ from 0.3 px, so that no pixel is off by 5e-7 of the light.
fn node_count(widths: f64, cycles: f64) -> usize {
    match widths {
        _ if cycles > 0.0 => (4.0 + 1.15 * widths + std::f64::consts::TAU * cycles).ceil() as usize,
        ..0.003 => 1,
        ..0.15 => 2,
        ..0.5 => 3,
        _ => (4.0 + 1.15 * widths).ceil() as usize,
    }
}

/// Nodes from 0 to 1 and weights, which add up to 1, for an even trail of so many widths of the point spread.
pub(super) fn nodes_along(widths: f64) -> Vec<[f64; 2]> {
    let parts = (widths / LONGEST_PIECE).ceil().max(1.0);
    let rule = gauss_legendre(node_count(widths / parts, 0.0));
    (0..parts as usize)
        .flat_map(|part| rule.iter().map(move |[node, weight]| [(part as f64 + 0.5 + 0.5 * node) / parts, weight / parts]))
        .collect()
}

/// A star seen by the scene's camera during an exposure.
struct Sight<'a> {
    scene: &'a Scene,
    exposure: &'a Exposure,
    star: StarState,
    electrons: f64,
    drifts: bool,
}

impl Sight<'_> {
    /// The place at a time from the middle of the exposure, after a turn of the camera by this vector (rad), all rows being exposed at once. What stands
    /// below the horizon of a site has none.
    fn place_turned(&self, time_s: f64, turn_rad: [f64; 3]) -> Option<PixelPoint> {
        let middle = self.exposure.sky.observation();
        let observation = if self.drifts { later(middle, time_s) } else { *middle };
        let apparent = self.exposure.sky.apparent_in(&self.star, &observation);
        if observation.zenith.is_some_and(|zenith| crate::dual::dot(apparent.xyz, zenith) < 0.0) {
            return None;
        }
        let mut attitude = self.exposure.motion.attitude(&self.exposure.course, time_s);
        if turn_rad != [0.0; 3] {
            attitude = attitude.turned(turn_rad);
        }
        let direction = attitude.camera_from_apparent(&apparent);
        if self.scene.optics.is_reference_behind_the_lens() {
            return self.scene.camera.pixel(&direction);
        }
        let image =
            ImageState { flux_e: Some(self.electrons), psf_sigma_px: Some(self.scene.detector.psf_sigma_px), ..ImageState::default() };
        self.scene.optics.pixel(&direction, &Context::new(self.star, observation).with_image(image))
    }

    /// See [`StarTrack::ideal`].
    fn ideal(&self) -> Option<PixelPoint> {
        let undisplaced = self.exposure.attitude.camera_from_apparent(&Direction::from_unit(self.star.direction));
        self.scene.undisplaced.pixel(&undisplaced, &Context::new(self.star, Observation::default()))
    }

    fn place(&self, time_s: f64) -> Option<PixelPoint> {
        self.place_turned(time_s, [0.0; 3])
    }

    /// The place at a time from the middle of the exposure of the row that is lit, and the time from that of the middle row.
    fn place_in_row(&self, time_s: f64) -> Option<(PixelPoint, f64)> {
        const ROUNDS: usize = 60;
        /// Rows beyond the frame to which the shutter's law is followed.
        const BEYOND_PX: f64 = 256.0;
        let line_s = self.scene.line_time_s;
        if line_s == 0.0 {
            return self.place(time_s).map(|place| (place, time_s));
        }
        let height = self.scene.camera.height_px as f64;
        let mut at = time_s;
        for _ in 0..ROUNDS {
            let place = self.place(at)?;
            let next = time_s + line_s * (place.y_px.clamp(-BEYOND_PX, height + BEYOND_PX) - 0.5 * (height - 1.0));
            if (next - at).abs() <= 1e-12 * line_s.abs() {
                return Some((place, at));
            }
            at = next;
        }
        self.place(at).map(|place| (place, at))
    }

    fn sample(&self, time_s: f64, weight: f64) -> Option<Sample> {
        let (place, at) = self.place_in_row(time_s)?;
        let line_s = self.scene.line_time_s;
        let mut shear = [0.0; 2];
        if line_s != 0.0 && !self.exposure.motion.is_still() {
            let step = SHEAR_ROWS * line_s;
            if let (Some(before), Some(after)) = (self.place(at - step), self.place(at + step)) {
                let of = |from: f64, to: f64| (to - from) / (2.0 * SHEAR_ROWS);
                shear = [of(before.x_px, after.x_px), of(before.y_px, after.y_px)];
                if shear.iter().all(|component| component.abs() < MIN_SHEAR) {
                    shear = [0.0; 2];
                }
            }
        }
        Some(Sample { time_s, weight, place, shear })
    }

    /// Covariance of the place under motion that is faster than the exposure.
    fn blur_px2(&self) -> [f64; 3] {
        const STEP_RAD: f64 = 1e-5;
        let mut blur = [0.0; 3];
        for (axis, variance) in self.exposure.motion.fast_rad2().into_iter().enumerate().filter(|(_, variance)| *variance > 0.0) {
            let turned = |by: f64| {
                let mut turn = [0.0; 3];
                turn[axis] = by;
                self.place_turned(0.0, turn)
            };
            if let (Some(before), Some(after)) = (turned(-STEP_RAD), turned(STEP_RAD)) {
                let slope = [after.x_px - before.x_px, after.y_px - before.y_px].map(|difference| difference / (2.0 * STEP_RAD));
                blur[0] += variance * slope[0] * slope[0];
                blur[1] += variance * slope[0] * slope[1];
                blur[2] += variance * slope[1] * slope[1];
            }
        }
        blur
    }
}

impl Scene {
    /// The stars that light frame number `index`, brightest first, each with its way over the frame.
    ///
    /// `width_px`: the width σ of the Gaussian that is as smooth as the narrowest point spread; `margin_px`: how far outside the frame a star
    /// may stand and still light it (the point spread's radius).
    ///
    /// # Panics
    /// If `index` is not below the number of exposures.
    #[must_use]
    pub fn star_tracks(&self, catalog: &Catalog, index: usize, width_px: f64, margin_px: f64) -> Vec<StarTrack> {
        let exposure = &*self.exposures.get(index);
        let candidates: Vec<&Star> = self.candidates(catalog, exposure, margin_px);
        let epoch_yr = catalog.epoch_yr;
        parallel::map(&candidates, |star| self.track(star, epoch_yr, exposure, width_px, margin_px)).into_iter().flatten().collect()
    }

    /// Some of the stars that light frame number `index`, and how many candidates each stands for: enough to tell what all of them cost.
    ///
    /// # Panics
    /// If `index` is not below the number of exposures.
    #[must_use]
    pub fn some_star_tracks(&self, catalog: &Catalog, index: usize, width_px: f64, margin_px: f64) -> (Vec<StarTrack>, f64) {
        const SOME: usize = 64;
        let exposure = &*self.exposures.get(index);
        let candidates: Vec<&Star> = self.candidates(catalog, exposure, margin_px);
        let step = (candidates.len() / SOME).max(1);
        let track = |star: &&Star| self.track(star, catalog.epoch_yr, exposure, width_px, margin_px);
        (candidates.iter().step_by(step).filter_map(track).collect(), step as f64)
    }

    /// The star images of frame number `index` that reach the frame at the middle of the exposure, brightest first.
    ///
    /// `margin_px`: how far outside the frame a star's centre may lie and still be listed (the PSF's radius).
    ///
    /// # Panics
    /// If `index` is not below the number of exposures.
    #[must_use]
    pub fn star_images(&self, catalog: &Catalog, index: usize, margin_px: f64) -> Vec<TrueStarImage> {
        let exposure = &*self.exposures.get(index);
        let image = |star: &Star| {
            let sight = self.sight(star, catalog.epoch_yr, exposure);
            let (position, _) = sight.place_in_row(0.0)?;
            let image = TrueStarImage { hip: star.hip, position, electrons: sight.electrons, magnitude: star.magnitude };
            self.holds(position, margin_px).then_some(image)
        };
        self.candidates(catalog, exposure, margin_px).into_iter().filter_map(image).collect()
    }

    fn sight<'a>(&'a self, star: &Star, epoch_yr: f64, exposure: &'a Exposure) -> Sight<'a> {
        let grey = self.detector.zero_point_e_per_s * 10.0_f64.powf(-0.4 * star.magnitude) * exposure.exposure_s;
        let electrons = grey * self.colour_response.relative(star.colour);
        let refracts = exposure.sky.ids().iter().any(|id| [ids::REFRACTION, ids::CHROMATIC_REFRACTION].contains(id));
        let drifts = refracts && exposure.sky.observation().zenith.is_some();
        Sight { scene: self, exposure, star: StarState::of(star, epoch_yr), electrons, drifts }
    }

    fn holds(&self, place: PixelPoint, margin_px: f64) -> bool {
        let reach = |centre: f64, length: usize| -0.5 - margin_px <= centre && centre <= length as f64 - 0.5 + margin_px;
        reach(place.x_px, self.camera.width_px) && reach(place.y_px, self.camera.height_px)
    }

    /// The stars near enough to the field of view, and bright enough.
    fn candidates<'c>(&self, catalog: &'c Catalog, exposure: &Exposure, margin_px: f64) -> Vec<&'c Star> {
        let middle = exposure.motion.attitude(&exposure.course, 0.0).rows()[2];
        let half_s = self.half_s(exposure);
        let steps = if exposure.motion.is_still() { 0 } else { exposure.motion.steps(half_s) };
        let sweep_rad = (0..=steps)
            .map(|step| {
                let time_s = half_s * (2.0 * step as f64 / steps.max(1) as f64 - 1.0);
                let boresight = exposure.motion.attitude(&exposure.course, time_s).rows()[2];
                crate::dual::dot(middle, boresight).clamp(-1.0, 1.0).acos()
            })
            .fold(0.0, f64::max);
        let cos_radius = (self.field_radius_rad(margin_px) + 1.1 * sweep_rad).min(std::f64::consts::PI).cos();
        catalog
            .stars
            .iter()
            .take_while(|star| star.magnitude <= self.sky.faintest_magnitude)
            .filter(|star| crate::dual::dot(star.direction.xyz, middle) > cos_radius)
            .collect()
    }

    /// From the middle of the exposure of the middle row to the farthest moment at which any row is exposed.
    fn half_s(&self, exposure: &Exposure) -> f64 {
        0.5 * exposure.exposure_s + 0.5 * self.line_time_s.abs() * self.camera.height_px as f64
    }

    fn track(&self, star: &Star, epoch_yr: f64, exposure: &Exposure, width_px: f64, margin_px: f64) -> Option<StarTrack> {
        let sight = self.sight(star, epoch_yr, exposure);
        let motion = &sight.exposure.motion;
        let exposure_s = sight.exposure.exposure_s;
        let moves = !motion.is_still() || sight.drifts;
        let place = |time_s| sight.place_in_row(time_s).map(|(place, _)| place);
        let (start_mid_end, samples) = if moves {
            let steps = motion.steps(0.5 * exposure_s).next_multiple_of(2);
            let coarse: Vec<_> = (0..=steps).map(|step| place(exposure_s * (step as f64 / steps as f64 - 0.5))).collect();
            ([coarse[0], coarse[steps / 2], coarse[steps]], self.samples(&sight, &coarse, width_px, margin_px))
        } else {
            let middle = sight.sample(0.0, 1.0)?;
            ([Some(middle.place); 3], vec![middle].into_iter().filter(|sample| self.holds(sample.place, margin_px)).collect())
        };
        if samples.is_empty() {
            return None;
        }
        let blur_px2 = sight.blur_px2();
        Some(StarTrack {
            hip: star.hip,
            magnitude: star.magnitude,
            colour: star.colour,
            temperature_offset_k: sight.exposure.sky.observation().temperature_offset_k.unwrap_or_default(),
            electrons: sight.electrons,
            ideal: sight.ideal(),
            start_mid_end,
            samples,
            blur_px2,
        })
    }

    /// The moments at which a star lights the frame, from its places at even steps of time through the exposure.
    fn samples(&self, sight: &Sight<'_>, coarse: &[Option<PixelPoint>], width_px: f64, margin_px: f64) -> Vec<Sample> {
        let exposure_s = sight.exposure.exposure_s;
        let motion = &sight.exposure.motion;
        let steps = coarse.len() - 1;
        let length = |pair: &[Option<PixelPoint>]| match (pair[0], pair[1]) {
            (Some(from), Some(to)) => (to.x_px - from.x_px).hypot(to.y_px - from.y_px),
            _ => 0.0,
        };
        let longest_step = coarse.windows(2).map(length).fold(0.0, f64::max);
        let near = |place: &Option<PixelPoint>| place.is_some_and(|place| self.holds(place, margin_px + 2.0 * longest_step));
        let mut breaks = motion.breaks(0.5 * exposure_s);
        breaks.insert(0, -0.5 * exposure_s);
        breaks.push(0.5 * exposure_s);
        let mut samples = Vec::new();
        for piece in breaks.windows(2) {
            let share = (piece[1] - piece[0]) / exposure_s;
            // The chord of a step is shorter than its arc; 1.05 holds for bends of up to a radian a step.
            let widths = 1.05 * longest_step * steps as f64 * share / width_px;
            let cycles = motion.most_cycles(exposure_s) * share;
            let parts = (widths / LONGEST_PIECE).max(cycles / 2.0).ceil().max(1.0) as usize;
            let nodes = gauss_legendre(node_count(widths / parts as f64, cycles / parts as f64));
            let part_s = (piece[1] - piece[0]) / parts as f64;
            for part in 0..parts {
                let from_s = piece[0] + part_s * part as f64;
                let place_in_steps = |time_s: f64| (time_s / exposure_s + 0.5) * steps as f64;
                let first = place_in_steps(from_s).floor().max(0.0) as usize;
                let last = (place_in_steps(from_s + part_s).ceil() as usize).min(steps);
                if !coarse[first.min(last)..=last].iter().any(near) {
                    continue;
                }
                let sample = |[node, weight]: &[f64; 2]| sight.sample(from_s + 0.5 * part_s * (1.0 + node), weight * share / parts as f64);
                samples.extend(nodes.iter().filter_map(sample).filter(|sample| self.holds(sample.place, margin_px)));
            }
        }
        samples
    }
}
