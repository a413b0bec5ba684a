//! Refinement of a candidate: the best camera that one frame gives, from a first attitude and focal length, and its false-match probability.

use std::f64::consts::PI;

use nalgebra::Vector3;

use super::false_match;
use super::fit::{MIN_FOR_KAPPA, MIN_FOR_PRINCIPAL, NEAR_REST_PX, fit};
use super::index::Index;
use super::overlay::{Near, Overlay, Taken};
use super::pose::{Pair, Points, Pose};
use super::projection::Projection;

/// A pose that the detections support.
#[derive(Clone, Debug)]
pub(super) struct Supported {
    pub(super) pose: Pose,
    /// ln of the least probability, over the depths and radii, that chance brings about as many matches.
    pub(super) ln_best: f64,
    /// ln of the probability that one hypothesis gets as much support by chance at any of them and at any look, at most.
    pub(super) ln_probability: f64,
    /// The detections that it was weighed on.
    pub(super) judges: usize,
}

/// Pairs that the triangle uses up.
const SPENT: usize = 3;
/// Radii, in frame sizes, within which matches are counted: from a quarter of a pixel in a thousand to several.
const RADII: [f64; 6] = [0.000_25, 0.000_7, 0.001_5, 0.003, 0.006, 0.012];
/// So many of them, the narrowest, speak at an early look: where only wider ones do, the pose is not yet what it can be.
const SHARP_RADII: usize = 3;
/// Catalogue stars laid over for one detection.
const DEPTHS: [f64; 4] = [0.4, 1.0, 2.0, 4.0];
/// Not more than these: of few detections most stars may be missing, of many there are enough among the brighter stars.
const MAX_OF_DEPTHS: usize = 96;
/// In the fit only so many stars are laid over that their circles cover this part of the frame: more would match by chance.
const COVERED: f64 = 0.04;
/// ln of the probability by chance that a first look must go below.
const FIRST_LOOK: f64 = -3.0;
/// Radii within which pairs are looked for, turn by turn, as parts of the widest of [`RADII`].
const TURNS: [f64; 6] = [1.0, 1.0, 0.6, 0.4, 0.3, 0.3];
/// After each of so many turns a hypothesis is weighed, and taken as it is if that is enough; and before the first of the likeliest triangles.
const EARLY_LOOKS: usize = 2;
/// Before the first turn, so much of the detections or of the stars laid over them must have a partner: a lens that bends more is fitted first.
const CLEAR: f64 = 0.6;
/// Each early look may use up this share of the false matches that are allowed, so that all looks together do not exceed them.
const EARLY_SHARE: f64 = 1e-3;

/// How deep the catalogue is laid over the detections that are used.
#[derive(Clone, Copy)]
struct Depths {
    used: usize,
    /// None is deeper than this.
    deepest: f64,
}

impl Depths {
    fn stars(self, share: f64) -> usize {
        ((self.used as f64 * share) as usize).max(8)
    }

    fn all(self) -> impl Iterator<Item = usize> {
        let shares = DEPTHS.into_iter().filter(move |share| *share <= self.deepest);
        shares.filter(move |share| *share <= 2.0 || self.stars(*share) <= MAX_OF_DEPTHS).map(move |share| self.stars(share))
    }

    fn most(self) -> usize {
        self.all().max().unwrap_or(8)
    }
}

/// Weighs a hypothesis as its triangle has it, on no more stars than there are detections; `None` unless that is enough. What a plain frame needs
/// is then one fit. `index` with the directions as they appear in this frame; for the rest see [`refine`].
pub(super) fn first_look(
    pose: &Pose,
    points: &Points,
    (index, vectors): (&Index, &[Vector3<f64>]),
    judges: usize,
    ln_enough: f64,
) -> Option<Supported> {
    let used = points.centred_px.len().min(judges);
    let depths = Depths { used, deepest: 1.0 };
    let in_frame = index.brightest_in_frame(pose, points, depths.most());
    let overlay = Overlay::new(pose, points, vectors, &in_frame, depths.most());
    let near = overlay.near(pose, points, used, RADII[SHARP_RADII - 1] * points.size_px);
    let pairs = overlay.paired(&near, used);
    if (pairs.len() as f64) < CLEAR * used.min(overlay.len()) as f64 {
        return None;
    }
    let ln_best = weigh(&overlay, &near, pose, points, depths, &RADII[..SHARP_RADII], SPENT);
    let ln_probability = over_all_looks(ln_best, EARLY_SHARE);
    if ln_probability >= ln_enough {
        return None;
    }
    // One step: the rest is done by the fit to all stars.
    let pose = fit(pose, points, vectors, &pairs, false, f64::INFINITY)?;
    Some(Supported { pose, ln_best, ln_probability, judges: used })
}

/// Refines a hypothesis and weighs it on the brightest `judges` detections; `None` as soon as it is plain that it is no better
/// than chance. It goes no further where ln of the probability is below `ln_enough`.
///
/// `vectors` are the directions as they appear in this frame, `near` the catalogue stars (brightest first) that may be in it.
pub(super) fn refine(
    pose: &Pose,
    points: &Points,
    vectors: &[Vector3<f64>],
    near: &[u32],
    judges: usize,
    ln_enough: f64,
) -> Option<Supported> {
    let used = points.centred_px.len().min(judges);
    let depths = Depths { used, deepest: f64::INFINITY };
    let wide = RADII[RADII.len() - 1] * points.size_px;
    let area = points.area_px2();
    let sparse = |radius_px: f64| ((COVERED * area / (PI * radius_px * radius_px)) as usize).clamp(8, depths.most());
    let weigh_anew = |radii: &[f64], pose: &Pose, spent: usize| {
        let overlay = Overlay::new(pose, points, vectors, near, depths.most());
        let near = overlay.near(pose, points, used, radii[radii.len() - 1] * points.size_px);
        weigh(&overlay, &near, pose, points, depths, radii, spent)
    };
    let mut pose = *pose;
    let (mut fitted_kappa, mut fitted_principal, mut last) = (false, false, (Vec::<Pair>::new(), false));
    // A first look at the wide radius dismisses nearly all that are wrong.
    for (turn, radius) in TURNS.into_iter().enumerate() {
        let radius_px = radius * wide;
        let overlay = Overlay::new(&pose, points, vectors, near, sparse(radius_px));
        let pairs = overlay.pairs(&pose, points, used, radius_px);
        if pairs.len() < 4 {
            return None;
        }
        if turn == 0 {
            let by_chance = overlay.density_at_points(&pose, points, used, usize::MAX) * PI * radius_px * radius_px;
            if false_match::ln_poisson_tail(by_chance, pairs.len() - 3) > FIRST_LOOK {
                return None;
            }
        }
        let fit_kappa = turn > 0 && pairs.len() >= MIN_FOR_KAPPA;
        // The same pairs lead to where the pose is already.
        let asked = (pairs, fit_kappa);
        if asked != last {
            pose = fit(&pose, points, vectors, &asked.0, fit_kappa, NEAR_REST_PX)?;
        }
        fitted_kappa |= fit_kappa;
        fitted_principal |= pose.projection != Projection::Pinhole && asked.0.len() >= MIN_FOR_PRINCIPAL;
        last = asked;
        if turn < EARLY_LOOKS {
            let ln_best = weigh_anew(&RADII[..SHARP_RADII], &pose, SPENT + usize::from(fitted_kappa) + usize::from(fitted_principal));
            let ln_probability = over_all_looks(ln_best, EARLY_SHARE);
            if ln_probability < ln_enough {
                return Some(Supported { pose, ln_best, ln_probability, judges: used });
            }
        }
    }
    let ln_best = weigh_anew(&RADII, &pose, SPENT + usize::from(fitted_kappa) + usize::from(fitted_principal));
    let ln_probability = over_all_looks(ln_best, 1.0 - (EARLY_LOOKS + 1) as f64 * EARLY_SHARE);
    Some(Supported { pose, ln_best, ln_probability, judges: used })
}

/// A bound on the probability that chance does as well at any depth, any radius and any look, from ln of the least of one and the share of
/// false matches that this look may use up.
fn over_all_looks(ln_best: f64, share: f64) -> f64 {
    ln_best + ((RADII.len() * DEPTHS.len()) as f64 / share).ln()
}

/// ln of the least probability, over depths and radii, that chance brings about as many matches beyond the `spent` first.
/// `near`: the points and stars within the widest radius of each other.
fn weigh(overlay: &Overlay, near: &[Near], pose: &Pose, points: &Points, depths: Depths, radii: &[f64], spent: usize) -> f64 {
    let used = depths.used;
    let area = |radius: f64| PI * (radius * points.size_px).powi(2);
    let (mut best, mut taken) = (0.0_f64, Taken::default());
    for depth in depths.all() {
        // The pairs within a radius are the first of those within a larger one.
        let mut matched = [0_usize; RADII.len()];
        overlay.pair_up(near, depth, used, &mut taken, |one| {
            let distance = one.distance2_px2;
            if let Some(narrowest) = radii.iter().position(|radius| distance <= (radius * points.size_px).powi(2)) {
                matched[narrowest] += 1;
            }
        });
        let least = overlay.least_density(points, used, depth);
        let mut density = None;
        let mut within = 0;
        for (radius, more) in radii.iter().zip(matched) {
            within += more;
            // Only where it could be the best is the density around each point asked for.
            if within > spent && false_match::ln_poisson_tail(least * area(*radius), within - spent) < best {
                let density = *density.get_or_insert_with(|| overlay.density_at_points(pose, points, used, depth));
                best = best.min(false_match::ln_poisson_tail(density * area(*radius), within - spent));
            }
        }
    }
    best
}
