//! What findings leave on frames and stars that took no part: χ² per degree of freedom by effect.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::images::right_names;
use crate::blind::answer::Answer;
use crate::blind::generate::{Family, Truth};

/// χ² of the channels in which an effect was found, on frames and stars that took no part, over all recordings that name it rightly.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct HeldOutChi2 {
    /// The effect's name in tables.
    pub label: String,
    /// Recordings.
    pub recordings: usize,
    /// Degrees of freedom.
    pub dof: f64,
    /// χ² per degree of freedom without the finding.
    pub before: f64,
    /// The same with all that was found.
    pub after: f64,
}

/// The label of all effects together.
const ALL_EFFECTS: &str = "all effects";
/// That of what nothing leaves, before the channel.
const NOTHING: &str = "nothing, ";

impl HeldOutChi2 {
    /// Where it stands among all: nulls, effects by name, their sum.
    pub(super) fn place(&self) -> (bool, bool, String) {
        (!self.label.starts_with(NOTHING), self.label == ALL_EFFECTS, self.label.clone())
    }

    /// More recordings of the same.
    pub(super) fn add(&mut self, more: &Self) {
        let share = more.dof / (self.dof + more.dof);
        self.before += share * (more.before - self.before);
        self.after += share * (more.after - self.after);
        (self.recordings, self.dof) = (self.recordings + more.recordings, self.dof + more.dof);
    }
}

/// By channel of plain nulls, which say what the noise that was found leaves where nothing is missing; then by effect, and of all effects last. Single
/// effects, from twice what is just seen on.
pub(super) fn held_out_chi2(given: &[(&Truth, &Answer)]) -> Vec<HeldOutChi2> {
    const FROM: f64 = 1.9;
    let mut sums: BTreeMap<&str, HeldOutChi2> = BTreeMap::new();
    for (truth, answer) in given.iter().filter(|(truth, _)| truth.family == Family::ImageLadder) {
        for effect in truth.effects.iter().filter(|effect| effect.multiple >= FROM) {
            let right = right_names(effect);
            let named = answer.findings.iter().find(|finding| right.contains(&finding.id.as_str()));
            let Some(finding) = named.filter(|finding| !finding.held_out_chi2.is_empty()) else { continue };
            let own = sums.entry(&effect.label).or_default();
            own.recordings += 1;
            for [before, after, dof] in finding.held_out_chi2.values() {
                own.before += before * dof;
                own.after += after * dof;
                own.dof += dof;
            }
        }
    }
    let all = sums.values().fold(HeldOutChi2::default(), |sum, own| HeldOutChi2 {
        recordings: sum.recordings + own.recordings,
        dof: sum.dof + own.dof,
        before: sum.before + own.before,
        after: sum.after + own.after,
        ..sum
    });
    let finished = |(label, own): (&str, HeldOutChi2)| HeldOutChi2 {
        label: label.to_owned(),
        before: own.before / own.dof,
        after: own.after / own.dof,
        ..own
    };
    let every = (all.recordings > 0).then_some((ALL_EFFECTS, all));
    nulls(given).into_iter().chain(sums.into_iter().chain(every).map(finished)).collect()
}

/// The plain nulls, channel by channel.
fn nulls(given: &[(&Truth, &Answer)]) -> Vec<HeldOutChi2> {
    let mut sums: BTreeMap<&str, HeldOutChi2> = BTreeMap::new();
    for (_, answer) in given.iter().filter(|(truth, _)| truth.family == Family::ImageNull) {
        for (channel, [per_dof, dof]) in &answer.held_out_by_channel {
            let own = sums.entry(channel).or_default();
            (own.recordings, own.dof, own.after) = (own.recordings + 1, own.dof + dof, own.after + per_dof * dof);
        }
    }
    let finished = |(channel, own): (&str, HeldOutChi2)| {
        let per_dof = own.after / own.dof;
        HeldOutChi2 { label: format!("{NOTHING}{channel}"), before: per_dof, after: per_dof, ..own }
    };
    sums.into_iter().map(finished).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::blind::generate::concealed;
    use crate::blind::generate::images::IMAGE_KINDS;
    use crate::catalog::Catalog;

    /// χ² is summed over the recordings, and a wrong name counts for nothing.
    #[test]
    fn chi2_is_pooled_over_the_recordings_that_name_the_effect() {
        let truth = (IMAGE_KINDS.len() as u32..300) // behind the lowest rung
            .map(|index| concealed(Family::ImageLadder, index, 5, Catalog::embedded()).truth)
            .find(|truth| truth.effects.iter().any(|effect| effect.multiple >= 2.0))
            .unwrap();
        let answer = |id: &str, told: [f64; 3]| {
            let mut answer = Answer::none(Family::ImageLadder, truth.index, 5, String::new());
            answer.error = None;
            answer.findings = vec![crate::blind::answer::AnswerFinding {
                id: id.to_owned(),
                parameters: Vec::new(),
                located_by: Vec::new(),
                snr: 9.0,
                delta_chi2: 81.0,
                set: Vec::new(),
                held_out_chi2: [("flux".to_owned(), told)].into(),
            }];
            answer
        };
        let id = truth.effects[0].id.clone();
        let answers = [answer(&id, [1.5, 1.0, 100.0]), answer(&id, [2.0, 1.2, 300.0]), answer("no-effect", [9.0, 9.0, 900.0])];
        let given: Vec<(&Truth, &Answer)> = answers.iter().map(|answer| (&truth, answer)).collect();
        let found = held_out_chi2(&given);
        let [own, all] = &found[..] else { panic!("{found:?}") };
        assert_eq!((own.recordings, own.dof), (2, 400.0));
        assert!((own.before - 1.875).abs() < 1e-12 && (own.after - 1.15).abs() < 1e-12, "{own:?}");
        assert_eq!(all.after, own.after);
    }
}
