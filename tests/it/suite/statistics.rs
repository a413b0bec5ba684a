//! What the verdicts of a suite claim, against the scatter of many suites: at the exact limit a PASS is as rare as asked for, and where the truth is
//! better by four standard errors no suite fails.

use boresight::suite::{ErrorRates, MetricSample, RequirementLimit, RequirementVerdict, Unit, looks, pooled, spent, strata, verdict};
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

const CONFIDENCE: f64 = 0.95;
/// Of 1000 suites at a probability of 5 %, 66 or fewer pass in 99 of 100 cases.
const MOST_OF_1000: usize = 66;
/// The same of 10,000.
const MOST_OF_10_000: usize = 551;

/// A kind of metric: how a sample grows by frames, from the distance of the truth to the limit in its own units.
struct Kind {
    name: &'static str,
    limit: RequirementLimit,
    /// Frames of a suite.
    frames: usize,
    /// The sample of frames drawn with the truth better than the limit by so many standard errors.
    draw: fn(&mut Pcg64, usize, f64) -> Frames,
}

/// All frames of a suite, of which the first ones can be looked at.
struct Frames(Box<dyn Fn(usize) -> MetricSample>);

fn normal(chance: &mut Pcg64) -> f64 {
    StandardNormal.sample(chance)
}

const RATE: f64 = 0.05;

fn draw_share(chance: &mut Pcg64, frames: usize, better: f64) -> Frames {
    let truth = RATE - better * (RATE * (1.0 - RATE) / frames as f64).sqrt();
    let hits: Vec<bool> = (0..frames).map(|_| chance.random::<f64>() < truth).collect();
    Frames(Box::new(move |n| MetricSample::Share { hits: hits[..n].iter().filter(|hit| **hit).count() as u64, trials: n as u64 }))
}

/// Twenty stars a frame; in one of ten frames all are missed together more often.
fn draw_stars(chance: &mut Pcg64, frames: usize, better: f64) -> Frames {
    const STARS: usize = 20;
    let spread = 0.5 * RATE;
    // Variance of a frame's share: binomial, and that of the frames' own shares.
    let variance = RATE * (1.0 - RATE) / STARS as f64 + spread * spread;
    let truth = RATE - better * (variance / frames as f64).sqrt();
    let units: Vec<Unit> = (0..frames)
        .map(|_| {
            let share = truth + if chance.random::<bool>() { spread } else { -spread };
            let sum = (0..STARS).filter(|_| chance.random::<f64>() < share).count();
            Unit { sum: sum as f64, count: STARS as f64 }
        })
        .collect();
    Frames(Box::new(move |n| MetricSample::ClusteredShare(units[..n].to_vec())))
}

/// The 90th percentile of an exponential quantity; the limit is ln 10.
fn draw_quantile(chance: &mut Pcg64, frames: usize, better: f64) -> Frames {
    let error = (0.9_f64 * 0.1 / frames as f64).sqrt() / 0.1;
    let scale = (10.0_f64.ln() - better * error) / 10.0_f64.ln();
    let values: Vec<f64> = (0..frames).map(|_| -scale * (1.0 - chance.random::<f64>()).ln()).collect();
    Frames(Box::new(move |n| MetricSample::Quantile { units: (0..n).collect(), values: values[..n].to_vec(), share: 0.9 }))
}

/// The size of a mean; the limit is 1.
fn draw_mean(chance: &mut Pcg64, frames: usize, better: f64) -> Frames {
    let truth = 1.0 - better * 2.0 / (frames as f64).sqrt();
    let values: Vec<f64> = (0..frames).map(|_| truth + 2.0 * normal(chance)).collect();
    Frames(Box::new(move |n| MetricSample::Mean(values[..n].to_vec())))
}

/// The length of a mean vector of two axes; the limit is 1.
fn draw_bias(chance: &mut Pcg64, frames: usize, better: f64) -> Frames {
    let truth = 1.0 - better * 2.0 / (frames as f64).sqrt();
    let axis = |chance: &mut Pcg64, middle: f64| -> Vec<f64> { (0..frames).map(|_| middle + 2.0 * normal(chance)).collect() };
    let axes = [axis(chance, 0.8 * truth), axis(chance, -0.6 * truth)];
    Frames(Box::new(move |n| MetricSample::Bias(axes.iter().map(|axis| axis[..n].to_vec()).collect())))
}

/// The root mean square of normal errors of two axes; the limit is 1.
fn draw_rms(chance: &mut Pcg64, frames: usize, better: f64) -> Frames {
    let square = 1.0 - better * (1.0 / frames as f64).sqrt();
    let mut one = || square * (normal(chance).powi(2) + normal(chance).powi(2));
    let units: Vec<Unit> = (0..frames).map(|_| Unit { sum: one(), count: 2.0 }).collect();
    Frames(Box::new(move |n| MetricSample::RootMeanSquare { units: units[..n].to_vec(), factor: 1.0 }))
}

const KINDS: [Kind; 6] = [
    Kind { name: "share of frames", limit: RequirementLimit::AtMost(RATE), frames: 640, draw: draw_share },
    Kind { name: "share of stars", limit: RequirementLimit::AtMost(RATE), frames: 160, draw: draw_stars },
    Kind { name: "quantile", limit: RequirementLimit::AtMost(std::f64::consts::LN_10), frames: 320, draw: draw_quantile },
    Kind { name: "mean", limit: RequirementLimit::AtMost(1.0), frames: 160, draw: draw_mean },
    Kind { name: "bias", limit: RequirementLimit::AtMost(1.0), frames: 160, draw: draw_bias },
    Kind { name: "rms", limit: RequirementLimit::AtMost(1.0), frames: 160, draw: draw_rms },
];

fn errors(requirements: usize) -> ErrorRates {
    ErrorRates { false_pass: 1.0 - CONFIDENCE, false_fail: (1.0 - CONFIDENCE) / requirements as f64 }
}

fn fixed(frames: &Frames, count: usize, limit: RequirementLimit, errors: ErrorRates) -> RequirementVerdict {
    verdict(&(frames.0)(count).bounds(limit.risk(errors)).unwrap(), limit)
}

fn auto(frames: &Frames, most: usize, limit: RequirementLimit, errors: ErrorRates) -> RequirementVerdict {
    let looks = looks(20, most);
    let count = looks.len();
    let at = |(index, look): (usize, usize)| fixed(frames, look, limit, spent(errors, index, count));
    looks.into_iter().enumerate().map(at).find(|verdict| *verdict != RequirementVerdict::Undecided).unwrap_or(RequirementVerdict::Undecided)
}

#[test]
fn at_the_exact_limit_few_suites_pass() {
    for kind in &KINDS {
        for (way, judge) in [("fixed", fixed as fn(&Frames, usize, RequirementLimit, ErrorRates) -> RequirementVerdict), ("auto", auto)] {
            let mut chance = Pcg64::seed_from_u64(1);
            let mut one = || judge(&(kind.draw)(&mut chance, kind.frames, 0.0), kind.frames, kind.limit, errors(1));
            let verdicts: Vec<RequirementVerdict> = (0..1000).map(|_| one()).collect();
            let passes = verdicts.iter().filter(|verdict| **verdict == RequirementVerdict::Pass).count();
            let fails = verdicts.iter().filter(|verdict| **verdict == RequirementVerdict::Fail).count();
            println!("{}, {way}: {passes} PASS and {fails} FAIL of 1000 at the exact limit", kind.name);
            assert!(passes <= MOST_OF_1000, "{}, {way}: {passes}", kind.name);
            assert!(fails <= MOST_OF_1000, "{}, {way}: {fails} FAIL", kind.name);
            // The test has power: a bound that is never met would pass it too.
            assert!(passes + fails > 5, "{}, {way}: {passes} + {fails}", kind.name);
        }
    }
}

/// One requirement at its limit and nine that are met with ease: the suite passes as seldom as with one. All ten at their limits: far more seldom.
#[test]
fn ten_requirements_pass_no_oftener_than_one() {
    for kind in &KINDS {
        for (way, judge) in [("fixed", fixed as fn(&Frames, usize, RequirementLimit, ErrorRates) -> RequirementVerdict), ("auto", auto)] {
            let mut chance = Pcg64::seed_from_u64(2);
            let (mut passes, mut all_at_limit, mut fails) = (0, 0, 0);
            for _ in 0..1000 {
                let mut one = |better| judge(&(kind.draw)(&mut chance, kind.frames, better), kind.frames, kind.limit, errors(10));
                let easy: Vec<RequirementVerdict> = (0..9).map(|_| one(6.0)).collect();
                let last = one(0.0);
                let is_met = |verdict: &RequirementVerdict| *verdict == RequirementVerdict::Pass;
                passes += usize::from(easy.iter().all(is_met) && is_met(&last));
                let hard: Vec<RequirementVerdict> = (0..9).map(|_| one(0.0)).chain([last]).collect();
                all_at_limit += usize::from(hard.iter().all(is_met));
                fails += usize::from(hard.contains(&RequirementVerdict::Fail));
            }
            println!("{}, {way}, ten requirements: {passes} PASS; all at the limit {all_at_limit} PASS, {fails} FAIL of 1000", kind.name);
            assert!(passes <= MOST_OF_1000 && all_at_limit <= 3, "{}, {way}: {passes}, {all_at_limit}", kind.name);
            assert!(fails <= MOST_OF_1000, "{}, {way}: {fails} FAIL", kind.name);
        }
    }
}

#[test]
fn no_suite_fails_where_the_truth_is_better_by_four_standard_errors() {
    for kind in &KINDS {
        for (way, judge) in [("fixed", fixed as fn(&Frames, usize, RequirementLimit, ErrorRates) -> RequirementVerdict), ("auto", auto)] {
            let mut chance = Pcg64::seed_from_u64(3);
            let mut counts = [0_usize; 3];
            for _ in 0..3000 {
                let found = judge(&(kind.draw)(&mut chance, kind.frames, 4.0), kind.frames, kind.limit, errors(1));
                counts[found as usize] += 1;
            }
            let [pass, fail, undecided] = counts;
            println!("{}, {way}: {pass} PASS, {fail} FAIL, {undecided} UNDECIDED of 3000 at four standard errors", kind.name);
            assert_eq!(fail, 0, "{}, {way}", kind.name);
            assert!(pass > 1500, "{}, {way}: {pass} of 3000 pass", kind.name);
        }
    }
}

/// The negative control: bounds without a margin, that is at a risk of a half, pass half the suites at the limit.
#[test]
fn bounds_without_a_margin_pass_half_of_the_suites() {
    let mut chance = Pcg64::seed_from_u64(4);
    let rates = ErrorRates { false_pass: 0.5, false_fail: 0.5 };
    let kind = &KINDS[3];
    let pass = (0..1000)
        .filter(|_| fixed(&(kind.draw)(&mut chance, kind.frames, 0.0), kind.frames, kind.limit, rates) == RequirementVerdict::Pass)
        .count();
    assert!((400..600).contains(&pass), "{pass}");
}

/// The components of a nested design: what is put in comes out, and at the exact limit few suites pass. Satterthwaite's degrees of freedom are an
/// approximation, so ten thousand suites are counted.
#[test]
fn components_of_variance_are_those_that_were_put_in() {
    let truth = [0.7_f64, 0.5, 0.9]; // noise, pixel, field
    let mut chance = Pcg64::seed_from_u64(5);
    let mut passes = [0; 3];
    let mut sums = [0.0; 3];
    for _ in 0..10_000 {
        let mut axis = || -> Vec<Vec<Vec<f64>>> {
            let fields = (0..12).map(|_| {
                let field = truth[2] * normal(&mut chance);
                let places: Vec<Vec<f64>> = (0..6)
                    .map(|_| {
                        let place = field + truth[1] * normal(&mut chance);
                        (0..3).map(|_| 2.0 + place + truth[0] * normal(&mut chance)).collect()
                    })
                    .collect();
                places
            });
            fields.collect()
        };
        let [x, y] = [axis(), axis()].map(|values| strata(&values));
        let both: Vec<_> = x.into_iter().zip(y).map(|(x, y)| pooled(x, y).unwrap()).collect();
        for (level, truth) in truth.into_iter().enumerate() {
            let limit = RequirementLimit::AtMost(truth);
            let bounded = MetricSample::Component { strata: both.clone(), level }.bounds(limit.risk(errors(1))).unwrap();
            sums[level] += bounded.value * bounded.value / 10_000.0;
            passes[level] += usize::from(verdict(&bounded, limit) == RequirementVerdict::Pass);
        }
    }
    println!("components: {passes:?} PASS of 10,000 at the exact limit");
    for ((pass, sum), truth) in passes.into_iter().zip(sums).zip(truth) {
        assert!((300..=MOST_OF_10_000).contains(&pass), "{passes:?}");
        assert!((sum - truth * truth).abs() < 0.03, "{sums:?}");
    }
}

/// Errors with heavy tails (one of twenty ten times as large): the degrees of freedom shrink, and the bounds keep most of what they claim.
#[test]
fn heavy_tails_cost_degrees_of_freedom() {
    let mut chance = Pcg64::seed_from_u64(6);
    let square = 0.95 + 0.05 * 100.0;
    let limit = RequirementLimit::AtMost(1.0);
    let mut passes = 0;
    for _ in 0..1000 {
        let mut one = || {
            let scale = if chance.random::<f64>() < 0.05 { 10.0 } else { 1.0 };
            (scale * normal(&mut chance)).powi(2) / square
        };
        let units: Vec<Unit> = (0..2000).map(|_| Unit { sum: one(), count: 1.0 }).collect();
        let bounded = MetricSample::RootMeanSquare { units, factor: 1.0 }.bounds(limit.risk(errors(1))).unwrap();
        passes += usize::from(verdict(&bounded, limit) == RequirementVerdict::Pass);
    }
    println!("heavy tails: {passes} PASS of 1000 at the exact limit");
    assert!(passes <= 80, "{passes}");
}
