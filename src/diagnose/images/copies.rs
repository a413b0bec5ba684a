//! Copies of bright stars at other places: of another amplifier, of the lens, of the frame before.
//!
//! A copy is in proportion to its star: the sums at all partner places are held against the light of their stars. Now and then a star that was not found
//! stands there; what is there by chance is taken from places beside the partners. A sum S counts by its rank among those, as the normal number z of that
//! rank (van der Waerden's scores: Hájek and Šidák, *Theory of Rank Tests* (1967)), so that no sum counts for more than chance has shown. With a = F/σ and
//! w = a, or min(a, that of the brightest fifth or twentieth)
//!
//! ```text
//! T = Σ w·z / √(R·Σ w²),   c from Σ w·ψ((S/σ − a·c − m)/s) = 0
//! ```
//! R what T² is at the places beside where it is more than one: places that stay with the same stars from frame to frame count but once; m and s the
//! location and scale of the sums there, ψ cut at [`CLIP`] (Huber, *Robust Statistics* (1981)). A name stands where odd and even frames show the same,
//! and two halves of the stars that weigh as much as each other, as far as that can be.

use super::counted::{Counted, MAX_SURPRISE};
use crate::diagnose::causes::{GHOST, PERSISTENCE};
use crate::diagnose::channels::Channel;
use crate::effects::detector::crosstalk::Crosstalk;
use crate::effects::pixel::pass::PassHead;
use crate::pixel_statistics::{CONTROLS, ElsewhereFrame, LOOKS, Partner, PartnerSum};
use crate::statistics::significance::{deviations, neg_ln_chi2_sf};
use crate::statistics::{mad_sigma, median};

const CROSSTALK: &str = <Crosstalk as PassHead>::ID;
/// No sum counts for more in the size, standard errors.
const CLIP: f64 = 2.5;
/// Fewer frames, sums and places beside them tell nothing.
const MIN_FRAMES: usize = 4;
const MIN_SUMS: usize = 24;
const MIN_BESIDE: usize = 100;
/// Each half shows a copy at so many standard errors, and at least this share of what the other shows.
const HALF_SHOWS: f64 = 2.0;
const HALF_SHARE: f64 = 1.0 / 3.0;
/// No star has more weight than one brighter than this share of all: copies that all stars show, those that only the brightest do, and those of the very
/// brightest, by which most of what there is to know of a faint copy is told.
const EQUAL_FROM: [f64; 3] = [0.8, 0.95, 1.0];

/// Of a factor that `count` numbers tell the largest that two of its errors allow.
pub(super) fn at_most(factor: f64, count: usize) -> f64 {
    factor * (1.0 + 2.0 * (2.0 / count.max(1) as f64).sqrt())
}

/// Value and standard error, to two digits of the error.
pub(super) fn told(value: f64, sigma: f64) -> String {
    let digits = (1.0 - sigma.max(1e-12).log10().floor()).clamp(0.0, 9.0) as usize;
    format!("{value:.digits$} ± {sigma:.digits$}")
}

/// The sums of one look, and what is there by chance.
struct Sums<'a> {
    /// Place of the frame among those that have sums, and the sum.
    all: Vec<(usize, &'a PartnerSum)>,
    /// Location and scale of the places beside, and the variance of ψ there.
    middle: f64,
    scale: f64,
    variance: f64,
    /// No star has more weight.
    most: f64,
    /// The places beside in their order, and the normal number of every rank among them.
    beside: Vec<f64>,
    ranks: Vec<f64>,
}

/// The normal number of every rank among so many.
fn normal_scores(count: usize) -> Vec<f64> {
    let score = |rank: usize| {
        let below = (rank as f64 + 0.5) / (count as f64 + 1.0);
        let sigmas = deviations(-(2.0 * below.min(1.0 - below)).ln());
        if below < 0.5 { -sigmas } else { sigmas }
    };
    (0..=count).map(score).collect()
}

fn light(sum: &PartnerSum) -> f64 {
    sum.flux_dn / sum.sigma_dn
}

/// The half, 0 or 1, of each star, given by its frame, rank and weight: those of a frame from the brightest on, each to the half that weighs less. Most of
/// what is known of a copy is told by a few stars; odd and even ones would leave a half with little.
fn halves(stars: &[(usize, usize, f64)]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..stars.len()).collect();
    order.sort_by_key(|index| (stars[*index].0, stars[*index].1));
    let (mut halves, mut weights, mut of) = (vec![0; stars.len()], [0.0; 2], None);
    for index in order {
        let (frame, _, weight) = stars[index];
        if of != Some(frame) {
            (of, weights) = (Some(frame), [0.0; 2]);
        }
        let half = usize::from(weights[1] < weights[0]);
        halves[index] = half;
        weights[half] += weight;
    }
    halves
}

impl<'a> Sums<'a> {
    fn of(frames: &'a [ElsewhereFrame], look: usize, equal_from: f64) -> Option<Self> {
        let of_look = |frame: &'a ElsewhereFrame| frame.sums.iter().filter(move |sum| sum.look == look);
        let with_sums = frames.iter().filter(|frame| of_look(frame).next().is_some());
        let all: Vec<(usize, &PartnerSum)> =
            with_sums.enumerate().flat_map(|(place, frame)| of_look(frame).map(move |sum| (place, sum))).collect();
        let mut beside: Vec<f64> = all.iter().flat_map(|(_, sum)| sum.controls).filter(|value| value.is_finite()).collect();
        let frames = all.last().map_or(0, |(place, _)| place + 1);
        if frames < MIN_FRAMES || all.len() < MIN_SUMS || beside.len() < MIN_BESIDE {
            return None;
        }
        let (mut middle, scale) = (median(&beside)?, mad_sigma(&beside)?.max(1.0));
        let count = beside.len() as f64;
        let psi = |value: &f64, middle: f64| ((value - middle) / scale).clamp(-CLIP, CLIP);
        for _ in 0..10 {
            middle += scale * beside.iter().map(|value| psi(value, middle)).sum::<f64>() / count;
        }
        let variance = beside.iter().map(|value| psi(value, middle).powi(2)).sum::<f64>() / count;
        let mut lights: Vec<f64> = all.iter().map(|(_, sum)| light(sum)).collect();
        lights.sort_by(f64::total_cmp);
        let most = lights[((lights.len() as f64 * equal_from) as usize).min(lights.len() - 1)];
        beside.sort_by(f64::total_cmp);
        let ranks = normal_scores(beside.len());
        (variance > 0.0).then_some(Self { all, middle, scale, variance, most, beside, ranks })
    }

    fn psi(&self, value: f64) -> f64 {
        ((value - self.middle) / self.scale).clamp(-CLIP, CLIP)
    }

    /// T of lights and sums in units of their errors, R = 1.
    fn score(&self, values: impl Iterator<Item = (f64, f64)>) -> f64 {
        let add = |(sum, square): (f64, f64), (a, u): (f64, f64)| {
            let weight = a.min(self.most);
            (sum + weight * self.ranks[self.beside.partition_point(|value| *value < u)], square + weight * weight)
        };
        let (sum, square) = values.fold((0.0, 0.0), add);
        if square > 0.0 { sum / square.sqrt() } else { 0.0 }
    }

    /// T at the places beside.
    fn chance(&self) -> impl Iterator<Item = f64> {
        (0..CONTROLS).map(|k| {
            let told = self.all.iter().map(move |(_, sum)| (light(sum), sum.controls[k]));
            self.score(told.filter(|(_, value)| value.is_finite()))
        })
    }

    /// T of a part of the sums, and the copy's share of the light with its standard error.
    fn part(&self, is_taken: impl Fn(usize) -> bool, inflation: f64) -> Part {
        let taken = || self.all.iter().enumerate().filter(|(index, _)| is_taken(*index)).map(|(_, (_, sum))| *sum);
        let told = |sum: &PartnerSum| (light(sum), sum.sum_dn / sum.sigma_dn);
        let score = self.score(taken().map(told)) / inflation.sqrt();
        // Stars with full pixels show a copy, but not how large a share it is.
        let values: Vec<(f64, f64)> = taken().filter(|sum| !sum.is_least).map(told).collect();
        let rest = |c: f64| values.iter().map(|(a, u)| a.min(self.most) * self.psi(u - a * c)).sum::<f64>();
        let reach = values.iter().map(|(a, u)| (u - self.middle).abs() / a).fold(0.0, f64::max);
        let [mut low, mut high] = [-reach, reach];
        for _ in 0..80 {
            let middle = f64::midpoint(low, high);
            if rest(middle) > 0.0 { low = middle } else { high = middle }
        }
        let relative = f64::midpoint(low, high);
        let is_inside = |a: f64, u: f64| self.psi(u - a * relative).abs() < CLIP;
        let slope: f64 = values.iter().filter(|(a, u)| is_inside(*a, *u)).map(|(a, _)| a * a.min(self.most)).sum::<f64>() / self.scale;
        let all: f64 = values.iter().map(|(a, _)| a.min(self.most).powi(2)).sum();
        let sigma = (self.variance * inflation * all).sqrt() / slope.max(f64::MIN_POSITIVE);
        Part { score, relative, sigma }
    }
}

#[derive(Clone, Copy, Debug)]
struct Part {
    score: f64,
    relative: f64,
    sigma: f64,
}

/// What one look shows.
#[derive(Clone, Copy, Debug)]
struct Shown {
    look: usize,
    whole: Part,
    surprise: f64,
    /// Whether all halves show it.
    agrees: bool,
}

impl Shown {
    fn of(sums: &Sums<'_>, look: usize, inflation: f64, tests: usize) -> Self {
        let whole = sums.part(|_| true, inflation);
        let by_frame = sums.all.iter().map(|(place, _)| place % 2).collect();
        let is_shown = |part: &Part| part.score * whole.score.signum() > HALF_SHOWS;
        let stars: Vec<_> = sums.all.iter().map(|(place, sum)| (*place, sum.rank, light(sum).min(sums.most).powi(2))).collect();
        let agrees = [by_frame, halves(&stars)].into_iter().all(|half_of: Vec<usize>| {
            let halves = [0, 1].map(|half| sums.part(|index| half_of[index] == half, inflation));
            let ratio = halves[0].relative / halves[1].relative;
            halves.iter().all(is_shown) && ratio > HALF_SHARE && ratio < HALF_SHARE.recip()
        });
        let surprise = neg_ln_chi2_sf(1.0, whole.score * whole.score) - (tests as f64).ln();
        Self { look, whole, surprise: surprise.clamp(0.0, MAX_SURPRISE), agrees }
    }

    fn partner(&self) -> Partner {
        LOOKS[self.look].partner
    }

    fn is_wide(&self) -> bool {
        LOOKS[self.look].wide_px.is_some()
    }

    fn is_found(&self) -> bool {
        self.agrees && Counted::is_surprising(self.surprise)
    }
}

/// Where a copy of the electronics lies, in words.
fn where_copied(partner: Partner) -> &'static str {
    match partner {
        Partner::MirroredColumn => "at the mirrored column",
        Partner::MirroredRow => "at the mirrored row",
        Partner::MirroredPoint => "at the point mirrored in the middle of the frame",
        Partner::HalfWidth => "half the width of the frame away",
        Partner::HalfHeight => "half the height of the frame away",
        Partner::FrameAfter => "at the same place of the next frame",
    }
}

/// All that partner places show; `other_tests`: how many are made beside these.
pub(super) fn copies(frames: &[ElsewhereFrame], other_tests: usize) -> Vec<Counted> {
    let ways = (0..LOOKS.len()).flat_map(|look| EQUAL_FROM.map(|equal_from| (look, equal_from)));
    let sums: Vec<(usize, Sums<'_>)> = ways.filter_map(|(look, equal_from)| Some((look, Sums::of(frames, look, equal_from)?))).collect();
    let beside: Vec<f64> = sums.iter().flat_map(|(_, sums)| sums.chance()).map(|score| score * score).collect();
    // All weights see the same sums.
    let independent = beside.len() / EQUAL_FROM.len();
    let inflation = at_most(beside.iter().sum::<f64>() / beside.len().max(1) as f64, independent).max(1.0);
    let tests = EQUAL_FROM.len() * LOOKS.len() + other_tests;
    let shown: Vec<Shown> = sums.iter().map(|(look, sums)| Shown::of(sums, *look, inflation, tests)).collect();
    let best = |is_asked: &dyn Fn(&Shown) -> bool| -> Option<Shown> {
        let order = |own: &Shown| (own.is_found(), own.surprise);
        shown.iter().filter(|own| is_asked(own)).copied().max_by(|a, b| {
            let (a, b) = (order(a), order(b));
            a.0.cmp(&b.0).then(a.1.total_cmp(&b.1))
        })
    };
    let is_amplifier = |own: &Shown| !matches!(own.partner(), Partner::MirroredPoint | Partner::FrameAfter);
    let crosstalk = best(&is_amplifier);
    let ghost = best(&|own| own.partner() == Partner::MirroredPoint).map(|own| of_its_width(own, &shown));
    // Of four amplifiers in the corners each has the copies of all others.
    let is_corner = ghost.is_some_and(|own| own.is_found() && !own.is_wide())
        && crosstalk.is_some_and(|own| own.is_found() && matches!(own.partner(), Partner::MirroredColumn | Partner::MirroredRow));
    vec![
        counted(CROSSTALK, crosstalk, None),
        of_ghost(ghost, is_corner),
        counted(PERSISTENCE, best(&|own| own.partner() == Partner::FrameAfter), Some(1.0)),
    ]
}

fn of_ghost(ghost: Option<Shown>, is_corner: bool) -> Counted {
    let own = counted(GHOST, ghost, Some(1.0));
    match ghost {
        _ if is_corner => own.withheld("the copies at mirrored columns or rows are of amplifiers in the corners, which do the same"),
        // As sharp as the stars: by its place alone it is the lens or two amplifiers in opposite corners.
        Some(shown) if !shown.is_wide() && shown.is_found() => own.or(&[CROSSTALK]),
        _ => own,
    }
}

/// A sharp weight sees the middle of a wide copy, and the wider the weight the more of it: the size is that of the first weight that holds it.
fn of_its_width(found: Shown, shown: &[Shown]) -> Shown {
    const WIDER: f64 = 1.3;
    const SIGMAS: f64 = 3.0;
    let mut own = found;
    for other in shown.iter().filter(|other| other.partner() == found.partner() && other.look > found.look) {
        let more = other.whole.relative - own.whole.relative;
        let is_more = more.abs() > SIGMAS * other.whole.sigma.hypot(own.whole.sigma);
        if is_more && other.whole.relative / own.whole.relative > WIDER {
            own = Shown { look: other.look, whole: other.whole, ..own };
        }
    }
    own
}

/// What is said of an effect.
fn counted(id: &'static str, shown: Option<Shown>, sign: Option<f64>) -> Counted {
    let Some(shown) = shown else {
        return Counted::untold(id, Channel::Background, "too few bright stars with a free place where they could leave a copy");
    };
    let Part { relative, sigma, .. } = shown.whole;
    let cause = match (id, shown.is_wide()) {
        (CROSSTALK, _) => "crosstalk between two amplifiers",
        (PERSISTENCE, _) => "charge that the detector releases late",
        (_, true) => "a reflection in the lens, out of focus",
        _ => "a reflection in the lens",
    };
    let verb = if relative < 0.0 { "take" } else { "leave" };
    let sentence =
        format!("Bright stars {verb} {} of their light {}: {cause}.", told(relative.abs(), sigma), where_copied(shown.partner()));
    let is_right_sign = sign.is_none_or(|sign| relative * sign > 0.0);
    let surprise = if is_right_sign { shown.surprise } else { 0.0 };
    let own = Counted::of_stars(id, Channel::Background, vec![("relative", relative, sigma, "")], surprise, "flux", sentence);
    if shown.agrees { own } else { own.withheld("halves of the frames or of the stars do not show the same") }
}

#[cfg(test)]
mod tests {
    use super::halves;

    /// Weights as those of a sky of stars, (rank + 1)⁻²: the lesser half has 0.38 of them, and odd ranks would have 0.25.
    #[test]
    fn halves_of_the_stars_weigh_as_much_as_they_can() {
        let stars: Vec<_> = (0..80).rev().map(|k| (k / 40, k % 40, ((k % 40 + 1) as f64).powi(-2))).collect();
        let of = halves(&stars);
        for frame in 0..2 {
            let sum = |is_own: &dyn Fn(usize) -> bool| -> f64 {
                (0..stars.len()).filter(|index| stars[*index].0 == frame && is_own(*index)).map(|index| stars[index].2).sum()
            };
            let share = |is_own: &dyn Fn(usize) -> bool| sum(is_own) / sum(&|_| true);
            let lesser = share(&|index| of[index] == 1);
            assert!((lesser - 0.383).abs() < 0.01, "{lesser}");
            assert!(share(&|index| stars[index].1 % 2 == 1) < 0.26);
        }
        // Of one star there is one half, and of the next frame the brightest is in the first again.
        assert_eq!(halves(&[(0, 0, 5.0), (1, 0, 4.0), (1, 1, 4.0)]), [0, 0, 1]);
    }
}
