//! The line of the zero points of the frames against their air mass (P. Bouguer's; Henden and Kaitchuck, *Astronomical Photometry* (1982), 4.4).
//!
//! The fit of the stars leaves every frame a zero point of its own, so that extinction is sized by what differs within the frames, and the zero points take no
//! part in it. They confirm it where they follow the air mass by as much, show it by themselves where they are on a line, and tell a low frame from one
//! behind clouds.

use nalgebra::{DMatrix, DVector};
use statrs::distribution::{ContinuousCDF, StudentsT};

use super::counted::{Counted, MAX_SURPRISE};
use super::frame_levels::{Air, CLEAR_NIGHT_MAG, Level, TestedFrame, levels};
use super::row_fit::RowFit;
use super::rows::Rows;
use super::selection::columns;
use super::zero_point_scatter::{PARABOLA, beside, smooth};
use crate::diagnose::causes::EXTINCTION;
use crate::diagnose::channels::Channel;
use crate::statistics::{mad_sigma, median, median_in_place};

/// Degrees of freedom at least, beside a parabola in the number of the frame (a lens that dews) and the slope.
const MIN_FREEDOM: usize = 4;
/// Beside the parabola the air masses scatter by so much at least,
const MIN_RMS_AIRMASS: f64 = 0.05;
/// and no air takes more than this, magnitudes per air mass.
const MAX_SLOPE: f64 = 2.0;
/// −ln of the probability at which the zero points confirm what the frames show within,
const CONFIRMS: f64 = 6.9;
/// where the sizes differ by no more than this many standard errors.
const AGREES: f64 = 3.3;
/// What the air takes beyond what is fitted, where the other frames do not tell it: zero with this standard deviation, magnitudes per air mass.
const ORDINARY: f64 = 0.3;

/// How the zero points of the frames follow the air mass.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct BouguerLine {
    /// Slope and standard error, magnitudes per air mass.
    pub(super) slope: [f64; 2],
    /// −ln of its probability by chance (Student's t, with the scatter of the zero points about the line), the largest with one of the frames left out: one
    /// low frame behind a cloud is no line.
    pub(super) surprise: f64,
}

impl BouguerLine {
    /// Of some zero points; nothing where they cannot tell or the slope is none of air, with every frame and without any one of them.
    pub(super) fn of(levels: &[Level]) -> Option<Self> {
        let without =
            |own: usize| -> Vec<Level> { levels.iter().enumerate().filter(|(k, _)| *k != own).map(|(_, level)| *level).collect() };
        let of_all = Self::of_these(levels)?;
        let least = (0..levels.len()).try_fold(of_all.surprise, |least, own| Some(Self::of_these(&without(own))?.surprise.min(least)))?;
        Some(Self { surprise: least, ..of_all })
    }

    fn of_these(levels: &[Level]) -> Option<Self> {
        let airmass: Vec<f64> = levels.iter().map(|level| level.airmass).collect::<Option<_>>()?;
        let freedom = levels.len().checked_sub(PARABOLA + 1).filter(|own| *own >= MIN_FREEDOM)?;
        let weight = DVector::from_iterator(levels.len(), levels.iter().map(|level| level.sigma.hypot(CLEAR_NIGHT_MAG).recip()));
        let parabola = DMatrix::from_diagonal(&weight) * smooth(levels.len(), None);
        let weighted = |of: &dyn Fn(usize) -> f64| (0..levels.len()).map(|k| of(k) * weight[k]).collect::<Vec<f64>>();
        let column = DVector::from_vec(beside(&parabola, &weighted(&|k| airmass[k] - 1.0))?);
        let value = DVector::from_vec(beside(&parabola, &weighted(&|k| levels[k].stars))?);
        let square = column.norm_squared();
        if square < MIN_RMS_AIRMASS.powi(2) * weight.norm_squared() {
            return None;
        }
        let slope = column.dot(&value) / square;
        let scatter = (value - &column * slope).norm_squared() / freedom as f64;
        if slope <= 0.0 || slope > MAX_SLOPE {
            return None;
        }
        let p_value = 2.0 * StudentsT::new(0.0, 1.0, freedom as f64).ok()?.sf(slope / (scatter / square).sqrt());
        // By chance the zero points of few frames scatter by less than their errors.
        Some(Self {
            slope: [slope, (scatter.max(1.0) / square).sqrt()],
            surprise: (-p_value.max(f64::MIN_POSITIVE).ln()).min(MAX_SURPRISE),
        })
    }
}

/// Slope of the zero points against the air mass, and its standard error, where they confirm the extinction that the stars show within the frames: a field
/// near the horizon may be the only one that shows it, and then no frames that are left out can.
pub(super) fn confirmed(
    rows: &Rows,
    (accepted, fit): (&[usize], &RowFit),
    question: usize,
    (air, tested): (&Air, &[TestedFrame]),
) -> Option<[f64; 2]> {
    if rows.questions[question].id != EXTINCTION {
        return None;
    }
    let first: usize = accepted.iter().take_while(|other| **other != question).map(|other| rows.questions[*other].columns.len()).sum();
    let [size, sigma] = [fit.size[first], fit.covariance[(first, first)].max(0.0).sqrt()];
    let others: Vec<usize> = accepted.iter().copied().filter(|other| *other != question).collect();
    let without = RowFit::under(rows, &fit.take, &columns(rows, &others), fit);
    let BouguerLine { slope: [slope, error], surprise } = BouguerLine::of(&levels(rows, &without, None, (None, air), tested))?;
    (surprise > CONFIRMS && (slope - size).abs() < AGREES * sigma.hypot(error)).then_some([slope, error])
}

/// Extinction that the zero points show by themselves.
pub(super) fn extinction(levels: &[Level]) -> Option<Counted> {
    let BouguerLine { slope: [slope, sigma], surprise } = BouguerLine::of(levels)?;
    let sentence = format!(
        "The zero points of the frames follow the air mass by {slope:.3} ± {sigma:.3} mag: the light that the air takes was left out."
    );
    let own = Counted::of_stars(EXTINCTION, Channel::Flux, vec![("mag_per_airmass", slope, sigma, "mag")], surprise, "zenith", sentence);
    own.is_found().then_some(own)
}

/// Every zero point less the line that those of the other frames have against the air mass, the error of the line in its own; as they are where the air mass
/// is not known. The slope is the median of those of all pairs (P. K. Sen, J. Am. Stat. Assoc. 63, 1379 (1968)): frames behind clouds do not turn it.
pub(super) fn beside_the_others(levels: &[Level]) -> Vec<Level> {
    let Some(airmass) = levels.iter().map(|level| level.airmass).collect::<Option<Vec<f64>>>() else { return levels.to_vec() };
    let of = |own: usize| -> Option<Level> {
        let others: Vec<[f64; 2]> = (0..levels.len()).filter(|k| *k != own).map(|k| [airmass[k], levels[k].stars]).collect();
        let slope = median_slope(&others).unwrap_or(0.0).clamp(-MAX_SLOPE, MAX_SLOPE);
        let middle = others.iter().map(|[x, _]| x).sum::<f64>() / others.len() as f64;
        let square: f64 = others.iter().map(|[x, _]| (x - middle).powi(2)).sum();
        let rest = |slope: f64| others.iter().map(|[x, y]| y - slope * (x - middle)).collect::<Vec<_>>();
        let error2 = mad_sigma(&rest(slope))?.max(CLEAR_NIGHT_MAG).powi(2) / square.max(f64::MIN_POSITIVE);
        // With what is known of air beforehand.
        let share = ORDINARY.powi(2) / (ORDINARY.powi(2) + error2);
        let (slope, sigma) = (slope * share, (error2 * share).sqrt());
        let off = airmass[own] - middle;
        let stars = levels[own].stars - slope * off - median(&rest(slope))?;
        Some(Level { stars, sigma: levels[own].sigma.hypot(sigma * off), ..levels[own] })
    };
    (0..levels.len()).map(|k| of(k).unwrap_or(levels[k])).collect()
}

/// The median of the slopes of all pairs of points; nothing where none differ along x.
fn median_slope(points: &[[f64; 2]]) -> Option<f64> {
    let mut slopes = Vec::new();
    for (k, [x, y]) in points.iter().enumerate() {
        slopes.extend(points[..k].iter().filter(|other| other[0] != *x).map(|other| (y - other[1]) / (x - other[0])));
    }
    median_in_place(&mut slopes)
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_distr::{Distribution, StandardNormal};
    use rand_pcg::Pcg64Mcg;

    use super::*;

    const FRAMES: usize = 12;

    /// Zero points on a line against the air mass, with the scatter of a clear night and their errors.
    fn on_a_line(seed: u64, mag_per_airmass: f64) -> Vec<Level> {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let mut level = |frame: usize| {
            let airmass = 1.0 + rng.random::<f64>();
            let sigma = 0.01 + 0.03 * rng.random::<f64>();
            let draw: f64 = StandardNormal.sample(&mut rng);
            Level {
                frame,
                stars: mag_per_airmass * (airmass - 1.5) + draw * sigma.hypot(CLEAR_NIGHT_MAG),
                sigma,
                sky: None,
                airmass: Some(airmass),
            }
        };
        (0..FRAMES).map(&mut level).collect()
    }

    /// Over many nights the slope scatters as its error says, and by chance there is one as seldom as its probability says.
    #[test]
    fn the_slope_and_its_probability_are_honest() {
        const NIGHTS: u64 = 2000;
        let (mut squares, mut by_chance) = (0.0, 0);
        for seed in 0..NIGHTS {
            let [slope, sigma] = BouguerLine::of(&on_a_line(seed, 0.9)).unwrap().slope;
            squares += ((slope - 0.9) / sigma).powi(2);
            by_chance += usize::from(BouguerLine::of(&on_a_line(seed, 0.0)).is_some_and(|own| own.surprise > -0.02_f64.ln()));
        }
        let rms = (squares / NIGHTS as f64).sqrt();
        // Errors are never smaller than stated; half of the slopes by chance are below zero, and 20 of the others are due at most, ± 4.5.
        assert!((0.75..1.1).contains(&rms), "{rms}");
        assert!((1..=34).contains(&by_chance), "{by_chance}");
    }

    /// A frame that is fainter since it is low is like the others; behind clouds it is not, wherever it stands.
    #[test]
    fn a_low_frame_is_on_the_line_of_the_others() {
        for seed in 0..20 {
            let mut levels = on_a_line(seed, 0.9);
            levels[3].stars += 1.2 * 0.9 - 0.9 * (levels[3].airmass.unwrap() - 1.5);
            levels[3].airmass = Some(2.7);
            let at = |levels: &[Level]| beside_the_others(levels)[3];
            let clear = at(&levels);
            assert!((clear.stars / clear.sigma.hypot(CLEAR_NIGHT_MAG)).abs() < 4.0, "seed {seed}: {clear:?}");
            for dimmer in [3, 5] {
                levels[dimmer].stars += 1.0;
            }
            let [low, other] = [3, 5].map(|k| beside_the_others(&levels)[k]);
            for own in [low, other] {
                assert!(
                    (own.stars - 1.0).abs() < 4.5 * own.sigma.hypot(CLEAR_NIGHT_MAG) && own.stars > 4.0 * own.sigma,
                    "seed {seed}: {own:?}"
                );
            }
        }
    }

    /// Two frames behind clouds are no extinction, neither at random air masses nor at both ends of them; extinction of a clear night is.
    #[test]
    fn two_frames_behind_clouds_are_no_extinction() {
        const NIGHTS: u64 = 2000;
        let (mut by_chance, mut at_the_ends, mut clear) = (0, 0, 0);
        for seed in 0..NIGHTS {
            let depth_mag = 0.2 + 0.01 * (seed % 100) as f64;
            let behind = |frames: [usize; 2]| {
                let mut levels = on_a_line(seed, 0.0);
                for frame in frames {
                    levels[frame].stars += depth_mag;
                }
                extinction(&levels).is_some()
            };
            by_chance += usize::from(behind([3, 8]));
            let airmass = |frame: &usize| on_a_line(seed, 0.0)[*frame].airmass.unwrap();
            let by_airmass = |a: &usize, b: &usize| airmass(a).total_cmp(&airmass(b));
            at_the_ends += usize::from(behind([(0..FRAMES).min_by(by_airmass).unwrap(), (0..FRAMES).max_by(by_airmass).unwrap()]));
            clear += usize::from(extinction(&on_a_line(seed, 0.9)).is_some());
        }
        assert!(by_chance == 0 && at_the_ends == 0 && clear > 1600, "{by_chance} {at_the_ends} {clear}");
    }

    /// Where all others stand equally high nobody knows what the air takes from the low one.
    #[test]
    fn one_low_frame_has_the_error_of_what_is_known_of_air() {
        let mut levels = on_a_line(1, 0.0);
        for level in &mut levels {
            level.airmass = Some(1.1);
        }
        levels[3].airmass = Some(2.1);
        levels[3].stars = 0.8;
        let own = beside_the_others(&levels)[3];
        assert!((own.sigma - ORDINARY).abs() < 0.01 && (own.stars - 0.8).abs() < 0.05, "{own:?}");
        assert_eq!(BouguerLine::of(&levels[..7]), None);
    }
}
