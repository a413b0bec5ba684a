//! The figures of recordings with effects hidden in their pixels.

use std::collections::{BTreeMap, BTreeSet};

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::count::{alarmed, first_name, summary};
use super::images_held_out::{HeldOutChi2, held_out_chi2};
use super::{Ladder, NullScore, Pulls, Rate};
use crate::blind::answer::Answer;
use crate::blind::generate::images::{HiddenImage, PixelKind, Reckoned};
use crate::blind::generate::{Family, Trap, TrueEffect, Truth};
use crate::statistics::order::ascending;

/// What all plain nulls together are called.
pub(super) const PLAIN_NULLS: &str = "all plain nulls";
/// Strong is what is hidden at four times what is just seen.
const STRONG: f64 = 3.9;
/// The name of what frames behind clouds have.
const CLOUDS: &str = "clouds";

/// What is named without being there: ids and how often.
pub type Names = BTreeMap<String, usize>;

/// Nulls of a kind, with the names given.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ImageNullScore {
    /// Counts.
    pub counts: NullScore,
    /// The names.
    pub names: Names,
    /// Channels said to be unexplained.
    pub unexplained: Names,
}

/// Answers about an effect at one strength.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ImageRung {
    /// Strength over what is just seen; of what is reckoned in steps, over the first step.
    pub multiple: f64,
    /// Recordings.
    pub of: usize,
    /// The first name is right.
    pub first: usize,
    /// The right name is among the names given.
    pub in_set: usize,
    /// It is withheld: significant, and not a finding.
    pub withheld: usize,
    /// Nothing is said of it, and nothing is said to be missing.
    pub silent: usize,
    /// Something is said to be missing, whatever its name.
    pub detected: usize,
    /// Names given that are wrong.
    pub wrong: Names,
    /// Median of the signal-to-noise ratios that could be hidden, over those asked for; 1 where no size had to be cut.
    pub reached: f64,
}

/// The ladder of an effect.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ImageLadder {
    /// The effect's name in tables.
    pub label: String,
    /// The id that is asked for.
    pub id: String,
    /// How its sizes are reckoned.
    pub reckoned: Reckoned,
    /// Whether the program that answered knows the effect at all.
    pub known: bool,
    /// Rungs, the weakest first.
    pub rungs: Vec<ImageRung>,
    /// Strength of half detection.
    pub half: Option<f64>,
    /// Sum, over the recordings from four times what is just seen on in which it is named, of the root of the fall of χ² over the signal-to-noise ratio
    /// of what was hidden, and their number: how much of the information in the pixels the program uses.
    #[serde(default)]
    pub snr_shares: f64,
    /// See `snr_shares`.
    #[serde(default)]
    pub sized: usize,
}

/// Effects that are hidden together.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ImagePairScore {
    /// Their names.
    pub label: String,
    /// All named, and nothing else.
    pub exact: Rate,
    /// Of two, the sum over the recordings of the cosines between what they change in the stamps, without sign; 0 where they are not both reckoned by stamps.
    #[serde(default)]
    pub cosines: f64,
    /// At least one named.
    pub one: Rate,
    /// Names given that are wrong.
    pub wrong: Names,
}

/// What single effects of four times what is just seen and more are called, all together.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ImagePool {
    /// The first name is right, where the effect is judged at all and has its whole size.
    pub first: Rate,
    /// The right name is printed, wherever a name is.
    pub in_set: Rate,
    /// The same of first names where the size had to be cut.
    pub first_of_cut: Rate,
    /// The same where the program says that it does not judge the effect.
    pub first_of_unjudged: Rate,
}

/// All figures.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ImageScore {
    /// Version of the program that answered.
    pub version: String,
    /// Seed.
    pub seed: u64,
    /// Which recordings were tried.
    pub recordings: BTreeMap<Family, BTreeSet<u32>>,
    /// Answers counted.
    pub answers: usize,
    /// Recordings without an answer, by reason.
    pub unanswered: Names,
    /// Nulls, plain and by trap; the totals of each last.
    pub nulls: Vec<ImageNullScore>,
    /// Ladders.
    pub ladders: Vec<ImageLadder>,
    /// The strong effects of all ladders.
    pub pool: ImagePool,
    /// Pairs.
    pub pairs: Vec<ImagePairScore>,
    /// More than two at once.
    #[serde(default)]
    pub groups: Vec<ImagePairScore>,
    /// Pulls of amplitudes where truth and finding are in the same parameter; of all of them last.
    pub pulls: Vec<Pulls>,
    /// Sizes over their errors of effects that are not found, of plain nulls.
    #[serde(default)]
    pub absent: Vec<Pulls>,
    /// χ² per degree of freedom of findings' own channels where nothing took part; of all of them last.
    #[serde(default)]
    pub held_out: Vec<HeldOutChi2>,
    /// Median and largest time of an answer, s.
    pub seconds: [f64; 2],
}

type Pair<'a> = (&'a Truth, &'a Answer);

/// Scores the answers about what is hidden in pixels; others are passed over.
#[must_use]
pub fn image_score(pairs: &[(Truth, Answer)]) -> ImageScore {
    let own: Vec<Pair> = pairs.iter().filter(|(truth, _)| truth.family.is_of_images()).map(|(truth, answer)| (truth, answer)).collect();
    let given: Vec<Pair> = own.iter().copied().filter(|(_, answer)| answer.error.is_none()).collect();
    let mut score = ImageScore { answers: given.len(), ..ImageScore::default() };
    for (truth, answer) in &own {
        (score.seed, score.version) = (truth.seed, answer.version.clone());
        score.recordings.entry(truth.family).or_default().insert(truth.index);
        if let Some(error) = &answer.error {
            *score.unanswered.entry(error.clone()).or_default() += 1;
        }
    }
    score.nulls = [Family::ImageNull, Family::ImageHardNull].into_iter().flat_map(|family| nulls(&given, family)).collect();
    score.ladders = ladders(&given);
    score.pool = pool(&given);
    score.pairs = together(&given, Family::ImageTwo);
    score.groups = together(&given, Family::ImageSeveral);
    score.pulls = pulls(&given);
    score.absent = absent(&given);
    score.held_out = held_out_chi2(&given);
    let mut seconds: Vec<f64> = given.iter().map(|(_, answer)| answer.seconds).collect();
    seconds.sort_by(f64::total_cmp);
    score.seconds = [seconds.get(seconds.len() / 2).copied().unwrap_or_default(), seconds.last().copied().unwrap_or_default()];
    score
}

/// The right answers to an effect: its id, and ids of the same trace.
pub(super) fn right_names(effect: &TrueEffect) -> Vec<&str> {
    let also = PixelKind::labelled(&effect.label).map_or(&[][..], PixelKind::also);
    [effect.id.as_str()].into_iter().chain(also.iter().copied()).collect()
}

fn count(names: &mut Names, name: &str) {
    *names.entry(name.to_owned()).or_default() += 1;
}

fn nulls(given: &[Pair], family: Family) -> Vec<ImageNullScore> {
    let fresh = |label: &str| ImageNullScore {
        counts: NullScore { label: label.to_owned(), named: Rate::default(), alarmed: Rate::default() },
        names: Names::new(),
        unexplained: Names::new(),
    };
    let total_label = if family == Family::ImageNull { PLAIN_NULLS } else { "all hard nulls" };
    let (mut kinds, mut total) = (BTreeMap::new(), fresh(total_label));
    for (truth, answer) in given.iter().filter(|(truth, _)| truth.family == family) {
        let trap = truth.trap.and_then(|trap| serde_json::to_value(trap).ok()?.as_str().map(str::to_owned));
        // What a trap truly has is no false name.
        let is_there = |id: &str| truth.trap == Some(Trap::Clouds) && id == CLOUDS;
        let label = trap.unwrap_or_else(|| format!("plain, {}", truth.setup));
        for own in [kinds.entry(label.clone()).or_insert_with(|| fresh(&label)), &mut total] {
            own.counts.named.count(answer.findings.iter().any(|finding| !is_there(&finding.id)));
            own.counts.alarmed.count(alarmed(answer));
            answer.findings.iter().for_each(|finding| count(&mut own.names, &finding.id));
            let unexplained = answer.channels.iter().filter(|(_, told)| told.starts_with("unexplained"));
            unexplained
                .for_each(|(channel, told)| count(&mut own.unexplained, &format!("{channel} {}", told.trim_start_matches("unexplained"))));
        }
    }
    let has_any = total.counts.named.of > 0;
    kinds.into_values().chain(has_any.then_some(total)).collect()
}

/// A ladder while its answers are counted.
struct Counting {
    own: ImageLadder,
    curve: Ladder,
    /// By rung: signal-to-noise ratios hidden over those asked for.
    reached: BTreeMap<usize, Vec<f64>>,
}

fn ladders(given: &[Pair]) -> Vec<ImageLadder> {
    let mut ladders: BTreeMap<String, Counting> = BTreeMap::new();
    for (truth, answer) in given.iter().filter(|(truth, _)| truth.family == Family::ImageLadder) {
        let Some(effect) = truth.effects.first() else { continue };
        let Counting { own, curve, reached } = ladders.entry(effect.label.clone()).or_insert_with(|| {
            let (label, id) = (effect.label.clone(), effect.id.clone());
            let reckoned = effect.reckoned.unwrap_or(Reckoned::Steps);
            let own = ImageLadder { label, id, reckoned, known: false, rungs: Vec::new(), half: None, snr_shares: 0.0, sized: 0 };
            Counting { own, curve: Ladder::default(), reached: BTreeMap::new() }
        });
        own.known |= is_judged(effect, answer);
        if let Some(share) = snr_share(effect, answer) {
            own.snr_shares += share;
            own.sized += 1;
        }
        curve.add(effect.multiple, alarmed(answer), false);
        let place = own.rungs.iter().position(|rung| (rung.multiple / effect.multiple - 1.0).abs() < 0.05).unwrap_or_else(|| {
            own.rungs.push(ImageRung { multiple: effect.multiple, ..ImageRung::default() });
            own.rungs.len() - 1
        });
        // Without information there is no signal to fall short of.
        let share = if effect.snr > 0.0 { effect.snr / (5.0 * effect.multiple) } else { 1.0 };
        reached.entry(place).or_default().push(share);
        add(&mut own.rungs[place], effect, answer);
    }
    let finish = |Counting { mut own, mut curve, reached }: Counting| {
        for (place, shares) in reached {
            own.rungs[place].reached = crate::statistics::median(&shares).unwrap_or(1.0);
        }
        ascending(&mut own.rungs, |a| a.multiple);
        curve.finish();
        own.half = curve.half;
        own
    };
    ladders.into_values().map(finish).collect()
}

/// The root of the fall of χ² over the signal-to-noise ratio of what was hidden, where it is strong enough that no threshold chooses which are found.
fn snr_share(effect: &TrueEffect, answer: &Answer) -> Option<f64> {
    let right = right_names(effect);
    let found = answer.findings.iter().find(|finding| right.contains(&finding.id.as_str()))?;
    (effect.multiple >= STRONG && effect.snr > 0.0).then(|| found.delta_chi2.max(0.0).sqrt() / effect.snr)
}

/// Whether the program that answered judges an effect.
fn is_judged(effect: &TrueEffect, answer: &Answer) -> bool {
    right_names(effect).iter().any(|id| answer.status_of(id).is_some_and(|status| status != "not-applicable"))
}

fn pool(given: &[Pair]) -> ImagePool {
    const WHOLE: f64 = 0.9;
    let mut pool = ImagePool::default();
    for (truth, answer) in given.iter().filter(|(truth, _)| truth.family == Family::ImageLadder) {
        for effect in truth.effects.iter().filter(|effect| effect.multiple >= STRONG) {
            let mut rung = ImageRung::default();
            add(&mut rung, effect, answer);
            let is_cut = effect.snr > 0.0 && effect.snr < WHOLE * 5.0 * effect.multiple;
            let first = match (is_judged(effect, answer), is_cut) {
                (false, _) => &mut pool.first_of_unjudged,
                (true, true) => &mut pool.first_of_cut,
                (true, false) => &mut pool.first,
            };
            first.count(rung.first > 0);
            if !answer.findings.is_empty() {
                pool.in_set.count(rung.in_set > 0);
            }
        }
    }
    pool
}

fn add(rung: &mut ImageRung, effect: &TrueEffect, answer: &Answer) {
    let right = right_names(effect);
    let is_right = |id: &str| right.contains(&id);
    let in_set = answer.findings.iter().any(|finding| is_right(&finding.id) || finding.set.iter().any(|other| is_right(other)));
    let withheld = answer.withheld.keys().any(|id| is_right(id));
    rung.of += 1;
    rung.first += usize::from(first_name(answer).is_some_and(is_right));
    rung.in_set += usize::from(in_set);
    rung.withheld += usize::from(withheld && !in_set);
    rung.detected += usize::from(alarmed(answer));
    rung.silent += usize::from(!withheld && !in_set && !alarmed(answer));
    answer.findings.iter().filter(|finding| !is_right(&finding.id)).for_each(|finding| count(&mut rung.wrong, &finding.id));
}

fn together(given: &[Pair], family: Family) -> Vec<ImagePairScore> {
    let mut pairs: BTreeMap<String, ImagePairScore> = BTreeMap::new();
    for (truth, answer) in given.iter().filter(|(truth, _)| truth.family == family) {
        let label = truth.effects.iter().map(|effect| effect.label.as_str()).collect::<Vec<_>>().join(" + ");
        let own = pairs.entry(label.clone()).or_insert_with(|| ImagePairScore { label, ..ImagePairScore::default() });
        let named = truth.effects.iter().filter(|effect| is_named(effect, answer)).count();
        let all_right: Vec<&str> = truth.effects.iter().flat_map(right_names).collect();
        let wrong: Vec<&str> = answer.findings.iter().map(|finding| finding.id.as_str()).filter(|id| !all_right.contains(id)).collect();
        own.exact.count(named == truth.effects.len() && wrong.is_empty());
        own.cosines += truth.pair_cos.unwrap_or_default().abs();
        own.one.count(named > 0);
        for id in wrong {
            count(&mut own.wrong, id);
        }
    }
    pairs.into_values().collect()
}

/// Whether an effect is among the names given.
fn is_named(effect: &TrueEffect, answer: &Answer) -> bool {
    let right = right_names(effect);
    answer.findings.iter().any(|finding| right.contains(&finding.id.as_str()))
}

/// Errors are those of a model that holds all that is there: of recordings in which something hidden is not named nothing is compared.
fn pulls(given: &[Pair]) -> Vec<Pulls> {
    const FROM: f64 = 1.9;
    let mut all: BTreeMap<String, Vec<f64>> = BTreeMap::new();
    let is_whole = |(truth, answer): &&Pair| truth.effects.iter().all(|effect| is_named(effect, answer));
    for (truth, answer) in given.iter().filter(is_whole) {
        for effect in truth.effects.iter().filter(|effect| effect.multiple >= FROM) {
            let size = effect.parameters.first().map_or(0.0, |parameter| parameter.value);
            let comparable = PixelKind::labelled(&effect.label).is_some_and(|kind| HiddenImage::is_comparable(kind, size));
            let Some(finding) = answer.findings.iter().find(|finding| comparable && finding.id == effect.id) else { continue };
            for parameter in &effect.parameters {
                if let Some(found) = finding.parameters.iter().find(|found| found.name == parameter.name && found.sigma > 0.0) {
                    let label = format!("{}.{}", effect.label, parameter.name);
                    all.entry(label).or_default().push((found.value - parameter.value) / found.sigma);
                }
            }
        }
    }
    let every: Vec<f64> = all.values().flatten().copied().collect();
    let of_all = (!every.is_empty()).then(|| summary("all", &every));
    all.iter().map(|(label, pulls)| summary(label, pulls)).chain(of_all).collect()
}

/// Sizes over their errors of effects that are not found: none was chosen by its size, and each null tells of as many as the program knows.
fn absent(given: &[Pair]) -> Vec<Pulls> {
    let mut all: BTreeMap<String, Vec<f64>> = BTreeMap::new();
    let nulls = given.iter().filter(|(truth, _)| truth.family == Family::ImageNull);
    for own in nulls.flat_map(|(_, answer)| &answer.not_found).filter(|own| own.parameter.sigma > 0.0) {
        all.entry(format!("{}.{}", own.id, own.parameter.name)).or_default().push(own.parameter.value / own.parameter.sigma);
    }
    all.iter().map(|(label, pulls)| summary(label, pulls)).collect()
}
