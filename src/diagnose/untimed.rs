//! Refraction in frames without times and place: one size, one declination of the zenith, and an hour angle for each frame. While the frames are
//! taken the Earth turns, and the zenith moves on its circle of declination: 15° an hour. One zenith for all frames would be blurred, and the size
//! found under it too small.
//!
//! The search for one zenith gives the start. From there size, declination and hour angles are found by Gauss and Newton's steps, attitudes and
//! camera free beside them; the hour angle is one more nuisance parameter of a frame, as its attitude is, so its error is in that of the size.

use super::evidence::Evidence;
use super::fit_state::{FitState, SelectedEffect};
use super::frame_nuisance::own_changes;
use super::hypotheses::Variant;
use super::linear_fit::Fit;
use super::linear_system::{Whitened, WhitenedSystem};
use super::noise::NoiseModel;
use super::zenith::{supposed, turned};
use crate::calibrate::{BundleSolution, Column};
use crate::dual::normalize;
use crate::statistics::order::descending;
use crate::statistics::student_t::cost;

/// Zeniths that the search starts from.
const STARTS: usize = 4;
/// Steps at most.
const STEPS: usize = 30;
/// An angle moves by so much in a step at most, rad.
const LONGEST_RAD: f64 = 0.15;
/// The steps end where all angles move by less, rad.
const SETTLED_RAD: f64 = 1e-4;
/// Half a night: hour angles lie within so much of their mean, rad.
const FARTHEST_RAD: f64 = std::f64::consts::FRAC_PI_2;
/// For derivatives the refraction has at least this size, arcsec: without any the zenith does not show.
const MIN_ARCSEC: f64 = 27.0;
/// Differences for derivatives with angles, rad.
const STEP_RAD: f64 = 1e-4;

/// Where the zenith stands.
#[derive(Clone, Debug)]
struct Zeniths {
    /// The one about which the hour angles lie.
    middle: [f64; 3],
    /// Turns of the frames' zeniths about the pole, rad.
    turns: Vec<f64>,
}

/// Replaces the one zenith of a refraction that was found by one for each frame.
pub(super) fn follow(evidence: &mut Evidence, joint: &BundleSolution, entries: &mut [SelectedEffect], all: &[bool], begin: &NoiseModel) {
    let untimed = evidence.frames.iter().all(|(_, observation)| observation.zenith.is_none() && observation.earth_from_icrs.is_none());
    if !untimed || evidence.frames.len() < 2 {
        return;
    }
    for k in 0..entries.len() {
        let SelectedEffect { hypothesis, variant } = entries[k];
        if evidence.hypotheses[hypothesis].variants[variant].zenith.is_none() {
            continue;
        }
        let stand = FitState::new(evidence, all, entries, begin);
        let others: Vec<SelectedEffect> = entries.iter().enumerate().filter(|(index, _)| *index != k).map(|(_, entry)| *entry).collect();
        let Some(found) = followed(evidence, joint, &stand, &others, entries[k]) else { continue };
        let variants = &mut evidence.hypotheses[hypothesis].variants;
        entries[k].variant = variants.len();
        variants.push(found);
    }
}

fn followed(
    evidence: &Evidence,
    joint: &BundleSolution,
    stand: &FitState,
    others: &[SelectedEffect],
    entry: SelectedEffect,
) -> Option<Variant> {
    let hypothesis = &evidence.hypotheses[entry.hypothesis];
    let beside: Vec<Whitened> = stand.white(evidence, others);
    let alone = stand.beside(beside.clone());
    // Those that explain most by themselves.
    let mut order: Vec<(f64, [f64; 3])> = hypothesis
        .variants
        .iter()
        .filter(|variant| variant.turns_rad.is_empty())
        .filter_map(|variant| {
            let own: Vec<Whitened> = variant.columns.iter().map(|column| evidence.white(&stand.noise, column)).collect();
            Some((alone.score(&own).0, variant.zenith?))
        })
        .collect();
    descending(&mut order, |a| a.0);
    let problem = Problem { evidence, joint, stand, beside, id: hypothesis.id() };
    let solved = order.iter().take(STARTS).filter_map(|(_, zenith)| problem.solve(*zenith));
    let (_, zeniths) = solved.min_by(|a, b| a.0.total_cmp(&b.0))?;
    let columns = vec![problem.column(&zeniths)?];
    let start = vec![0.0; hypothesis.effect.parameters().len()];
    let Zeniths { middle, turns } = zeniths;
    Some(Variant { start, zenith: Some(middle), turns_rad: turns, columns, searched_sigma: None, rendered: false })
}

struct Problem<'a> {
    evidence: &'a Evidence,
    joint: &'a BundleSolution,
    stand: &'a FitState,
    beside: Vec<Whitened>,
    id: &'static str,
}

impl Problem<'_> {
    /// The column of the size with the zeniths as they are, px/arcsec.
    fn column(&self, zeniths: &Zeniths) -> Option<Column> {
        let joint = supposed(self.joint, zeniths.middle, &zeniths.turns);
        joint.columns_of(self.id, &[0.0; 3], &[0])?.into_iter().next()
    }

    fn white(&self, zeniths: &Zeniths) -> Option<Whitened> {
        Some(self.evidence.white(&self.stand.noise, &self.column(zeniths)?))
    }

    /// Change of the displacement with an angle, for a refraction of this size.
    fn slope(&self, size: f64, moved: impl Fn(f64) -> Zeniths) -> Option<Whitened> {
        let (ahead, behind) = (self.white(&moved(STEP_RAD))?, self.white(&moved(-STEP_RAD))?);
        Some(ahead.iter().zip(&behind).map(|(a, b)| size * (a - b) / (2.0 * STEP_RAD)).collect())
    }

    /// From one zenith: the cost that is reached, and the zeniths there.
    fn solve(&self, start: [f64; 3]) -> Option<(f64, Zeniths)> {
        let Self { stand, beside, .. } = self;
        let (system, take) = (&stand.system, &stand.take);
        let mut now = Zeniths { middle: start, turns: vec![0.0; system.frames] };
        let mut reached = f64::INFINITY;
        let mut size = None;
        for _ in 0..STEPS {
            let unit = self.white(&now)?;
            let first: Vec<&Whitened> = beside.iter().chain([&unit]).collect();
            let at = system.camera.len() + beside.len();
            let known = size.unwrap_or_else(|| Fit::new(system, take, &first).change[at]);
            let scale = MIN_ARCSEC.max(known.abs()).copysign(known);
            let by_turn =
                self.slope(scale, |angle| Zeniths { turns: now.turns.iter().map(|turn| turn + angle).collect(), ..now.clone() })?;
            let by_declination = self.slope(scale, |angle| Zeniths { middle: risen(now.middle, angle), ..now.clone() })?;
            let own = system.own.iter().cloned().chain([by_turn]).collect();
            let system = WhitenedSystem { own, ..system.clone() };
            let more: Vec<&Whitened> = first.iter().copied().chain([&by_declination]).collect();
            let fit = Fit::new(&system, take, &more);
            reached = cost(&fit.residual, take, system.tail_degrees);
            let mut shared = system.residual.clone();
            for (column, change) in system.camera.iter().chain(more.iter().copied()).zip(fit.change.iter()) {
                shared.iter_mut().zip(column).for_each(|(value, column)| *value += change * column);
            }
            let turned = own_changes(&system, take, &shared, &fit.residual).pop()?;
            size = Some(fit.change[at]);
            let rise = fit.change[at + 1].clamp(-LONGEST_RAD, LONGEST_RAD);
            let mut most = rise.abs();
            now.middle = risen(now.middle, rise);
            for (turn, change) in now.turns.iter_mut().zip(turned) {
                let next = (*turn + change.clamp(-LONGEST_RAD, LONGEST_RAD)).clamp(-FARTHEST_RAD, FARTHEST_RAD);
                most = most.max((next - *turn).abs());
                *turn = next;
            }
            now.centre();
            if most < SETTLED_RAD {
                break;
            }
        }
        Some((reached, now))
    }
}

impl Zeniths {
    /// The same with the middle in the middle of the hour angles.
    fn centre(&mut self) {
        let mean = self.turns.iter().sum::<f64>() / self.turns.len().max(1) as f64;
        self.middle = turned(self.middle, mean);
        self.turns.iter_mut().for_each(|turn| *turn -= mean);
    }
}

/// A direction moved to the north.
fn risen([x, y, z]: [f64; 3], angle_rad: f64) -> [f64; 3] {
    const POLE: f64 = 1.57;
    let (declination, right_ascension) = (z.clamp(-1.0, 1.0).asin(), y.atan2(x));
    let declination = (declination + angle_rad).clamp(-POLE, POLE);
    let (sin, cos) = declination.sin_cos();
    normalize([cos * right_ascension.cos(), cos * right_ascension.sin(), sin])
}
