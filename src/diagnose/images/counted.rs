//! Findings of the noise that are counted and not fitted: defects, cosmic rays, what the converter and a compression did to the counts.

use std::collections::BTreeMap;

use crate::diagnose::causes::COMPRESSION;
use crate::diagnose::channels::{ByChannel, Channel, ChannelMeasure};
use crate::diagnose::diagnosis::{ColumnSource, EffectState, EffectStatus, Finding, FoundParameter, Signs};
use crate::effects::detector::crosstalk::Crosstalk;
use crate::effects::ids;
use crate::effects::pixel::pass::PassHead;
use crate::pixel_statistics::PixelStatistics;
use crate::statistics::significance::deviations;

/// Defects expected by chance in a recording, at most.
const EXPECTED_DEFECTS: f64 = 1e-2;
/// −ln of the probability that a finding needs.
const SURPRISE: f64 = 12.0;
/// Probabilities are not followed further.
pub(super) const MAX_SURPRISE: f64 = 700.0;

/// Why what a compression imitates is not told beside it.
pub(super) const COMPRESSED: &str = "the frames are compressed, which does the same";

/// One of them.
#[derive(Clone, Debug)]
pub(in crate::diagnose) struct Counted {
    id: &'static str,
    channel: Channel,
    /// Name, value, standard error, unit.
    parameters: Vec<(&'static str, f64, f64, &'static str)>,
    /// −ln of the probability by chance; 0 of what is not there.
    surprise: f64,
    follows: &'static str,
    sentence: String,
    /// Why nothing can be told, where that is so.
    reason: Option<String>,
    /// What leaves the same trace.
    alike: Vec<&'static str>,
    /// Why it has no name though it is beyond chance.
    against: Option<&'static str>,
}

/// What is found by counting, for what is fitted beside it.
#[derive(Clone, Debug, Default)]
pub(in crate::diagnose) struct FoundByCount {
    pub(in crate::diagnose) ids: Vec<&'static str>,
    /// The part of the counts of one amplifier that another adds to its own, with its standard error, where that is found.
    pub(in crate::diagnose) coupling: Option<[f64; 2]>,
    /// The ratio of gains, less one, that noise which neighbours share along one axis pretends, with its standard error, where they do.
    pub(in crate::diagnose) gain_by_memory: Option<[f64; 2]>,
}

impl FoundByCount {
    pub(in crate::diagnose) fn new(counted: &[Counted]) -> Self {
        let coupling =
            counted.iter().find(|own| own.found_id() == Some(<Crosstalk as PassHead>::ID)).and_then(|own| own.parameters.first());
        Self {
            ids: counted.iter().filter_map(Counted::found_id).collect(),
            coupling: coupling.map(|(_, value, sigma, _)| [*value, *sigma]),
            gain_by_memory: None,
        }
    }
}

/// −ln of the probability of so many where few are expected (Poisson).
pub(super) fn poisson_surprise(count: usize, expected: f64) -> f64 {
    let n = count as f64;
    if n <= expected { 0.0 } else { (n * (n / expected).ln() - n + expected).min(MAX_SURPRISE) }
}

/// All that the pixels show.
pub(in crate::diagnose) fn counted(pixels: &PixelStatistics) -> Vec<Counted> {
    let mut all = Vec::new();
    let pattern = &pixels.fixed_pattern;
    if pattern.pixels > 0 {
        all.push(Counted {
            channel: Channel::Noise,
            id: ids::HOT_PIXELS,
            parameters: vec![
                ("count", pattern.hot as f64, (pattern.hot as f64).sqrt(), ""),
                ("dead_count", pattern.dead as f64, (pattern.dead as f64).sqrt(), ""),
            ],
            surprise: poisson_surprise(pattern.hot + pattern.dead, EXPECTED_DEFECTS),
            follows: "pixel",
            reason: None,
            alike: Vec::new(),
            against: None,
            sentence: format!(
                "{} pixels stay far above their neighbours in frames of different pointings, {} far below.",
                pattern.hot, pattern.dead
            ),
        });
    }
    if let Some(jumping) = pattern.jumping {
        all.push(Counted {
            channel: Channel::Noise,
            id: ids::RANDOM_TELEGRAPH,
            parameters: vec![("count", jumping as f64, (jumping as f64).sqrt(), "")],
            surprise: poisson_surprise(jumping, EXPECTED_DEFECTS),
            follows: "pixel",
            reason: None,
            alike: Vec::new(),
            against: None,
            sentence: format!("{jumping} pixels jump from frame to frame by more than their noise."),
        });
    }
    all.extend(converter(pixels));
    let is_compressed = pixels.compression.as_ref().is_some_and(|found| -found.p_value.max(f64::MIN_POSITIVE).ln() > SURPRISE);
    if is_compressed {
        // Rounded blocks have codes of their own and sharp corners: what is counted there is their shadow.
        for own in &mut all {
            own.surprise = 0.0;
            own.reason = Some(COMPRESSED.to_owned());
        }
    }
    if let Some(found) = &pixels.compression {
        let mut parameters: Vec<_> = found.block_px.map(|block| ("block_px", f64::from(block), 0.0, "px")).into_iter().collect();
        parameters.extend(found.quantiser_dn.map(|step| ("quantiser_dn", step, 0.0, "DN")));
        all.push(Counted {
            channel: Channel::Noise,
            id: COMPRESSION,
            parameters,
            surprise: (-found.p_value.max(f64::MIN_POSITIVE).ln()).min(MAX_SURPRISE),
            follows: "block",
            reason: None,
            alike: Vec::new(),
            against: None,
            sentence: "The cosine transform of blocks of 8 × 8 pixels is rounded: the frames have been compressed as JPEG does.".to_owned(),
        });
    }
    all
}

/// Lost bits, missing and unequal codes.
fn converter(pixels: &PixelStatistics) -> Option<Counted> {
    let codes = pixels.codes.as_ref()?;
    let mut parameters = Vec::new();
    let mut surprise = 0.0_f64;
    let mut said = Vec::new();
    if let Some(lost) = codes.lost_bits.filter(|lost| *lost > 0) {
        parameters.push(("lost_bits", f64::from(lost), 0.0, ""));
        said.push(format!("the counts come in steps of {}: the lowest {lost} bits are always the same", 1_u32 << lost));
        surprise = MAX_SURPRISE;
    }
    if let Some(dnl) = &codes.dnl {
        parameters.push(("dnl_dn", dnl.dnl_dn, dnl.dnl_error_dn, "DN"));
        let own = (-dnl.p_value.max(f64::MIN_POSITIVE).ln()).min(MAX_SURPRISE);
        if own > SURPRISE {
            said.push(format!("codes are of unequal width, by {:.3} DN rms", dnl.dnl_dn));
        }
        surprise = surprise.max(own);
    }
    if let Some(missing) = codes.missing.as_ref().filter(|missing| missing.number > 0) {
        parameters.push(("missing_codes", missing.number as f64, 0.0, ""));
        said.push(format!("{} codes never come", missing.number));
        surprise = MAX_SURPRISE;
    }
    let mut sentence = said.join("; ");
    if let Some(first) = sentence.get(..1).map(str::to_uppercase) {
        sentence.replace_range(..1, &first);
        sentence.push('.');
    }
    (!parameters.is_empty()).then_some(Counted {
        channel: Channel::Noise,
        id: ids::ADC,
        parameters,
        surprise,
        follows: "code",
        sentence,
        reason: None,
        alike: Vec::new(),
        against: None,
    })
}

impl Counted {
    /// What stars show frame by frame, and is counted there.
    pub(super) fn of_stars(
        id: &'static str,
        channel: Channel,
        parameters: Vec<(&'static str, f64, f64, &'static str)>,
        surprise: f64,
        follows: &'static str,
        sentence: String,
    ) -> Self {
        Self { id, channel, parameters, surprise, follows, sentence, reason: None, alike: Vec::new(), against: None }
    }

    /// With why it has no name, whatever its probability.
    pub(super) fn withheld(self, against: &'static str) -> Self {
        Self { against: Some(against), ..self }
    }

    /// What cannot be told, and why.
    pub(super) fn untold(id: &'static str, channel: Channel, reason: impl Into<String>) -> Self {
        Self { reason: Some(reason.into()), ..Self::of_stars(id, channel, Vec::new(), 0.0, "", String::new()) }
    }

    /// With what leaves the same trace.
    pub(super) fn or(mut self, alike: &[&'static str]) -> Self {
        self.alike = alike.to_vec();
        self
    }

    /// Its id.
    pub(super) fn id(&self) -> &'static str {
        self.id
    }

    /// Its id, where it is there.
    pub(super) fn found_id(&self) -> Option<&'static str> {
        self.is_found().then_some(self.id)
    }

    /// Whether a surprise is one.
    pub(super) fn is_surprising(surprise: f64) -> bool {
        surprise > SURPRISE
    }

    /// The channel that it is of.
    pub(in crate::diagnose) fn channel(&self) -> Channel {
        self.channel
    }

    /// Whether it is there.
    pub(in crate::diagnose) fn is_found(&self) -> bool {
        self.surprise > SURPRISE && self.against.is_none()
    }

    /// Its status, and the finding if it is one.
    pub(in crate::diagnose) fn reported(self) -> (EffectStatus, Option<Finding>) {
        let is_found = self.is_found();
        let parameters: Vec<FoundParameter> = self
            .parameters
            .iter()
            .map(|(name, value, sigma, unit)| FoundParameter {
                name: (*name).to_owned(),
                value: *value,
                sigma: *sigma,
                unit: (*unit).to_owned(),
            })
            .collect();
        let p_value = (-self.surprise).exp();
        let against = self.against.filter(|_| self.surprise > SURPRISE);
        let status = EffectStatus {
            id: self.id.to_owned(),
            status: match (is_found, &self.reason) {
                (true, _) => EffectState::Found,
                (false, Some(_)) => EffectState::NotApplicable,
                (false, None) if against.is_some() => EffectState::Withheld,
                (false, None) => EffectState::NotFound,
            },
            p_value: Some(p_value),
            p_value_is: None,
            score_sigma: Some(deviations(self.surprise)),
            survival: None,
            parameters: parameters.clone(),
            upper_limit_95: None,
            held_out_delta_chi2: None,
            reason: self.reason.clone().or(against.map(str::to_owned)).unwrap_or_default(),
        };
        if !is_found {
            return (status, None);
        }
        let first = self.parameters.first().copied().unwrap_or_default();
        let measure = ChannelMeasure {
            delta_chi2: 2.0 * self.surprise,
            held_out_delta_chi2: None,
            held_out_chi2_per_dof: None,
            held_out_dof: None,
            amplitude: first.1,
            sigma: first.2,
        };
        let channels: ByChannel =
            Channel::ALL.into_iter().map(|channel| (channel, (channel == self.channel).then_some(measure))).collect::<BTreeMap<_, _>>();
        let finding = Finding {
            id: self.id.to_owned(),
            parameters,
            columns: ColumnSource::Formula,
            located_by: vec![self.follows.to_owned()],
            delta_chi2: 2.0 * self.surprise,
            p_value,
            p_value_is: None,
            family_p_value: p_value,
            family_p_value_is: None,
            held_out_delta_chi2: 0.0,
            held_out_expected: 0.0,
            held_out_score: 0.0,
            held_out_remark: Some("counted in all frames: nothing was held out".to_owned()),
            chosen_again: [0, 0],
            left_out: "nothing".to_owned(),
            signs: Signs::default(),
            resimulated_p_value: None,
            score_sigma: deviations(self.surprise),
            snr: if first.2 > 0.0 { first.1 / first.2 } else { 0.0 },
            channels,
            indistinguishable_from: self.alike.iter().map(|id| (*id).to_owned()).collect(),
            rivals: Vec::new(),
            decided_by: String::new(),
            known_amplitude: None,
            sentence: self.sentence,
        };
        (status, Some(finding))
    }
}
