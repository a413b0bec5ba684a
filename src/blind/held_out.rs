//! Is what is called held out held out? Over recordings in which nothing is hidden the held-out falls of χ² of all that was proposed have a
//! mean below zero; those of what was chosen with the held-out errors in hand have not.

use std::fmt::Write as _;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::answer::{Answer, AnswerProposal};

/// Proposals of a kind.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Proposals {
    /// The kind.
    pub label: String,
    /// How many.
    pub count: usize,
    /// Recordings with one.
    pub recordings: usize,
    /// Mean of the χ² of their scores on all star images, in sample.
    pub in_sample: f64,
    /// Mean of their held-out falls of χ².
    pub mean: f64,
    /// Standard error of that: recordings are independent, proposals of one are not.
    pub error: f64,
    /// Mean of what was to be expected of an effect of their size.
    pub expected: f64,
}

/// The study.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct HeldOutStudy {
    /// Recordings in which nothing is hidden.
    pub recordings: usize,
    /// Recordings without an answer.
    pub unanswered: usize,
    /// Probability of an alarm that was asked for.
    pub alpha: f64,
    /// The seed of the recordings.
    pub seed: u64,
    /// Proposals: all of them first.
    pub rows: Vec<Proposals>,
}

/// A kind of proposals: its name, and whether one is of it.
type Kind<'a> = (&'a str, &'a dyn Fn(&AnswerProposal) -> bool);

/// Counts the answers about recordings in which nothing is hidden.
#[must_use]
pub fn held_out_study(answers: &[Answer]) -> HeldOutStudy {
    let given: Vec<&Answer> = answers.iter().filter(|answer| answer.error.is_none()).collect();
    let kinds: [Kind; 5] = [
        ("all that was proposed", &|_| true),
        ("of these, by parts of a recording alone", &|own| !own.by_all_images),
        ("of these, by all star images together", &|own| own.by_all_images),
        ("of those, withheld", &|own| own.by_all_images && !own.named),
        ("of those, named: these have passed the test of it", &|own| own.named),
    ];
    let first = given.first();
    HeldOutStudy {
        recordings: answers.len(),
        unanswered: answers.len() - given.len(),
        alpha: first.map_or(0.0, |answer| answer.alpha),
        seed: first.map_or(0, |answer| answer.seed),
        rows: kinds.into_iter().map(|(label, is_of)| row(label, &given, is_of)).collect(),
    }
}

fn row(label: &str, given: &[&Answer], is_of: &dyn Fn(&AnswerProposal) -> bool) -> Proposals {
    let of = |answer: &&Answer| -> Vec<AnswerProposal> { answer.proposed.iter().filter(|own| is_of(own)).cloned().collect() };
    let by_recording: Vec<Vec<AnswerProposal>> = given.iter().map(of).filter(|own| !own.is_empty()).collect();
    let count = by_recording.iter().map(Vec::len).sum::<usize>();
    let all = || by_recording.iter().flatten();
    let over = 1.0 / count.max(1) as f64;
    let mean = all().map(|own| own.held_out_delta_chi2).sum::<f64>() * over;
    // A ratio of sums over recordings: its error is that of what each leaves of the mean.
    let left = |own: &Vec<AnswerProposal>| own.iter().map(|own| own.held_out_delta_chi2 - mean).sum::<f64>();
    Proposals {
        label: label.to_owned(),
        count,
        recordings: by_recording.len(),
        in_sample: all().map(|own| own.delta_chi2).sum::<f64>() * over,
        mean,
        error: by_recording.iter().map(|own| left(own).powi(2)).sum::<f64>().sqrt() * over,
        expected: all().map(|own| own.held_out_expected).sum::<f64>() * over,
    }
}

impl HeldOutStudy {
    /// Whether the mean over all that was proposed is not above zero by more than two standard errors.
    #[must_use]
    pub fn is_honest(&self) -> bool {
        self.rows.first().is_some_and(|all| all.count > 0 && all.mean <= 2.0 * all.error)
    }

    /// The page.
    #[must_use]
    pub fn markdown(&self, commit: &str) -> String {
        let mut page = String::new();
        let mut line = |text: &str| {
            let _ = writeln!(page, "{text}"); // writing to a String cannot fail
        };
        line("# Held out\n");
        line(&format!(
            "Written by `boresight blind held-out`; commit {commit}, seed {}, version {}. {} recordings in which nothing is hidden, {} without an answer, diagnosed with `--alpha {}`: so loose that chance is proposed often.\n",
            self.seed,
            env!("CARGO_PKG_VERSION"),
            self.recordings,
            self.unanswered,
            self.alpha
        ));
        line(
            "A recording is gone through in turns. Each leaves a part of the frames out (for effects that go by a star's own numbers half of the stars too), chooses and sizes effects on the rest, noise and searches included, and holds what it chose against what it left out. The held-out fall of χ² of an effect is the sum over the turns that chose it. Where nothing is hidden its mean is below zero over all that was proposed, by whatever part; an effect that all star images together propose was chosen with every error in hand, and one that is named has passed the test of this very figure besides, so that of these alone the mean is above zero.\n",
        );
        line("| proposals | number | recordings | χ² in sample, mean | held-out fall of χ², mean | expected of a true one |");
        line("|---|---|---|---|---|---|");
        for own in &self.rows {
            if own.count == 0 {
                line(&format!("| {} | 0 | 0 | – | – | – |", own.label));
                continue;
            }
            line(&format!(
                "| {} | {} | {} | {:.2} | {:+.2} ± {:.2} | {:.2} |",
                own.label, own.count, own.recordings, own.in_sample, own.mean, own.error, own.expected
            ));
        }
        line(&format!("\nMean over all at most zero, two standard errors allowed: {}.", if self.is_honest() { "yes" } else { "no" }));
        page
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::blind::generate::Family;

    #[test]
    fn proposals_of_one_recording_are_not_independent() {
        let proposal = |held_out_delta_chi2: f64, by_all_images: bool| AnswerProposal {
            id: "shear".to_owned(),
            named: false,
            by_all_images,
            delta_chi2: 10.0,
            held_out_delta_chi2,
            held_out_expected: 8.0,
            chosen_again: [1, 8],
        };
        let answer = |proposed: Vec<AnswerProposal>| Answer { error: None, proposed, ..Answer::none(Family::Null, 0, 1, String::new()) };
        let twice = held_out_study(&[answer(vec![proposal(-3.0, false), proposal(-3.0, false)]), answer(vec![proposal(3.0, true)])]);
        let (all, by_all) = (&twice.rows[0], &twice.rows[2]);
        assert_eq!((all.count, all.recordings, by_all.count), (3, 2, 1));
        assert!((all.mean + 1.0).abs() < 1e-12 && (all.error - 32.0_f64.sqrt() / 3.0).abs() < 1e-12, "{all:?}");
        assert!(twice.is_honest() && (by_all.mean - 3.0).abs() < 1e-12);
        let leaked: Vec<Answer> = (0..20).map(|k| answer(vec![proposal(5.0 + f64::from(k % 3), true)])).collect();
        assert!(!held_out_study(&leaked).is_honest());
        assert!(!held_out_study(&[]).is_honest(), "nothing proposed shows nothing");
    }
}
