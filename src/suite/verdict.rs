//! The verdict on a requirement in three values, and how many frames an undecided one needs.
//!
//! A requirement is met if the bound on its side meets the limit, and broken if the opposite bound breaks it. A suite is met only if all of its
//! requirements are, so each may be shown at the whole `confidence`: that a suite passes though one requirement is not met has at most the
//! probability of one false pass (intersection–union test: Berger, Technometrics 24, 295, 1982). It fails if one alone does, so what a false FAIL
//! may cost is divided among all of them (Bonferroni).

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::intervals::{Bounded, Risk};
use super::sample::{MetricSample, worth};

/// What is known of a requirement.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum RequirementVerdict {
    /// It is met, at the confidence asked for.
    Pass,
    /// It is not met, at the confidence asked for.
    Fail,
    /// The frames do not tell.
    Undecided,
}

impl RequirementVerdict {
    /// As it stands in tables.
    #[must_use]
    pub fn word(self) -> &'static str {
        match self {
            Self::Pass => "PASS",
            Self::Fail => "FAIL",
            Self::Undecided => "UNDECIDED",
        }
    }
}

/// On which side of the limit the value is to be.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum RequirementLimit {
    /// Not above.
    AtMost(f64),
    /// Not below.
    AtLeast(f64),
}

impl RequirementLimit {
    /// The number.
    #[must_use]
    pub fn value(self) -> f64 {
        let (Self::AtMost(limit) | Self::AtLeast(limit)) = self;
        limit
    }

    /// The sign that stands before the number.
    #[must_use]
    pub fn sign(self) -> &'static str {
        match self {
            Self::AtMost(_) => "≤",
            Self::AtLeast(_) => "≥",
        }
    }

    /// Whether a value keeps it.
    #[must_use]
    pub fn holds(self, value: f64) -> bool {
        match self {
            Self::AtMost(limit) => value <= limit,
            Self::AtLeast(limit) => value >= limit,
        }
    }

    /// The risks of both bounds, from those of a false PASS and of a false FAIL.
    #[must_use]
    pub fn risk(self, errors: ErrorRates) -> Risk {
        match self {
            Self::AtMost(_) => Risk { upper: errors.false_pass, lower: errors.false_fail },
            Self::AtLeast(_) => Risk { lower: errors.false_pass, upper: errors.false_fail },
        }
    }

    /// The bound that must keep the limit, and the one that breaks it.
    #[must_use]
    fn sides(self, bounded: &Bounded) -> [f64; 2] {
        match self {
            Self::AtMost(_) => [bounded.upper, bounded.lower],
            Self::AtLeast(_) => [bounded.lower, bounded.upper],
        }
    }
}

/// How often a verdict may be false.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ErrorRates {
    /// PASS though the requirement is not met.
    pub false_pass: f64,
    /// FAIL though it is met.
    pub false_fail: f64,
}

/// The verdict.
#[must_use]
pub fn verdict(bounded: &Bounded, limit: RequirementLimit) -> RequirementVerdict {
    let [must_keep, breaks] = limit.sides(bounded);
    if limit.holds(must_keep) {
        RequirementVerdict::Pass
    } else if !limit.holds(breaks) {
        RequirementVerdict::Fail
    } else {
        RequirementVerdict::Undecided
    }
}

/// About how many frames it takes in all until a requirement is decided, if what they show stays as it is; `None` where no number is enough (the value
/// is at its limit) or where more than `MAX_FRAMES` are needed. `frames` showed the sample.
#[must_use]
pub fn frames_to_decide(sample: &MetricSample, limit: RequirementLimit, errors: ErrorRates, frames: usize) -> Option<usize> {
    const MAX_FRAMES: f64 = 1e9;
    let risk = limit.risk(errors);
    let decided = |times: f64| {
        let bounded = match sample {
            MetricSample::Share { hits, trials } => {
                super::intervals::share((*hits as f64 * times).round(), (*trials as f64 * times).round(), risk)
            }
            MetricSample::Quantile { units, values, share } => grown_quantile(values, worth(units, values, *share), *share, times, risk)?,
            other => shrunk(&other.bounds(risk)?, times),
        };
        Some(verdict(&bounded, limit) != RequirementVerdict::Undecided)
    };
    let mut high = 1.0;
    while !decided(high)? {
        high *= 2.0;
        if high * frames as f64 > MAX_FRAMES {
            return None;
        }
    }
    let mut low = 0.5 * high;
    for _ in 0..40 {
        let middle = f64::midpoint(low, high);
        if decided(middle)? { high = middle } else { low = middle }
    }
    Some((high * frames as f64).ceil() as usize)
}

/// The bounds with so many times the frames: they come nearer as the root of it.
fn shrunk(bounded: &Bounded, times: f64) -> Bounded {
    let near = |bound: f64| bounded.value + (bound - bounded.value) / times.sqrt();
    let open = |bound: f64| if bound.is_infinite() && times > 4.0 { bounded.value } else { near(bound) };
    Bounded { value: bounded.value, lower: open(bounded.lower), upper: open(bounded.upper) }
}

/// The bounds of a quantile with each value so many times; all are worth `worth` independent ones.
fn grown_quantile(values: &[f64], worth: usize, share: f64, times: f64, risk: Risk) -> Option<Bounded> {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let total = (worth as f64 * times).round();
    // Ranks among the independent ones over those among all.
    let times = times * worth as f64 / sorted.len() as f64;
    // Ranks as the normal approximation has them, which is enough for "about".
    let sigma = (total * share * (1.0 - share)).sqrt();
    let z = |risk: f64| super::intervals::student_t(1.0 - risk, 1e6);
    let at = |rank: f64| sorted[((rank / times) as usize).min(sorted.len() - 1)];
    let (up, down) = (total * share + z(risk.upper) * sigma + 1.0, total * share - z(risk.lower) * sigma);
    sorted.first()?;
    Some(Bounded {
        value: f64::NAN,
        lower: if down < 1.0 { f64::NEG_INFINITY } else { at(down - 1.0) },
        upper: if up > total || total * share.ln() > risk.upper.ln() { f64::INFINITY } else { at(up - 1.0) },
    })
}

/// The fewest frames that could decide a requirement for the good, if nothing went wrong in any; `None`: the kind sets no such number.
#[must_use]
pub fn fewest_frames(kind: SampleKind, limit: RequirementLimit, false_pass: f64) -> Option<usize> {
    let frames = |share: f64| (false_pass.ln() / share.ln()).ceil() as usize;
    match (kind, limit) {
        (SampleKind::Share, RequirementLimit::AtLeast(share)) if share > 0.0 && share < 1.0 => Some(frames(share)),
        (SampleKind::Share, RequirementLimit::AtMost(share)) if share > 0.0 && share < 1.0 => Some(frames(1.0 - share)),
        (SampleKind::Quantile(share), RequirementLimit::AtMost(_)) => Some(frames(share)),
        (SampleKind::Quantile(share), RequirementLimit::AtLeast(_)) => Some(frames(1.0 - share)),
        (SampleKind::Mean | SampleKind::Square, _) => Some(2),
        _ => None,
    }
}

/// What kind of statistics a metric has.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SampleKind {
    /// A share of frames or, where they hang together, of stars.
    Share,
    /// A quantile.
    Quantile(f64),
    /// A mean, or the size of one.
    Mean,
    /// A mean square or a component of variance.
    Square,
    /// The largest value of the frames that were run.
    Largest,
}
