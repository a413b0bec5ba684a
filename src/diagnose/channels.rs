//! The six channels in which a recording can differ from its simulation, with a verdict for each. A verdict holds for the channels that were
//! examined and for no other: brightness may be off by half while every star position is right.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::verdict::{Bound, Verdict};
use crate::statistics::order::sort_by_key;

/// A way in which a recording may differ from its simulation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Channel {
    /// Places of star images.
    Astrometry,
    /// Their brightness.
    Flux,
    /// Second moments and skewness.
    Shape,
    /// What of the image no moment tells.
    Stamp,
    /// Variances, codes, rows and columns, fixed pattern, defects.
    Noise,
    /// The sky between the stars.
    Background,
}

impl Channel {
    /// All of them, in the order in which they are reported.
    pub const ALL: [Self; 6] = [Self::Astrometry, Self::Flux, Self::Shape, Self::Stamp, Self::Noise, Self::Background];

    /// As people call it.
    #[must_use]
    pub fn words(self) -> &'static str {
        match self {
            Self::Astrometry => "positions",
            Self::Flux => "brightness",
            Self::Shape => "shape",
            Self::Stamp => "stamps",
            Self::Noise => "noise",
            Self::Background => "background",
        }
    }
}

/// What is said of one channel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum ChannelVerdict {
    /// As the model has it, where the recording could have shown otherwise.
    Consistent,
    /// What was missing has a name, and the rest is consistent.
    Explained,
    /// Something is missing that no effect of the registry explains.
    Unexplained,
    /// Nothing shows, and no effect of ordinary size could have shown.
    Undecided,
    /// Nobody looked.
    #[default]
    NotLookedAt,
}

impl ChannelVerdict {
    /// In words.
    #[must_use]
    pub fn words(self) -> &'static str {
        match self {
            Self::Consistent => "consistent",
            Self::Explained => "explained",
            Self::Unexplained => "unexplained",
            Self::Undecided => "undecided",
            Self::NotLookedAt => "not looked at",
        }
    }
}

/// How large an effect has to be for this recording to show it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[non_exhaustive]
pub struct Detectable {
    /// The effect.
    pub id: String,
    /// Its first parameter.
    pub name: String,
    /// The parameter's unit.
    pub unit: String,
    /// An effect of this size would have been found in 95 of 100 such recordings; nothing where none would.
    pub size_95: Option<f64>,
    /// The size that real cameras and skies have.
    pub ordinary: f64,
    /// Where that size is from.
    pub source: String,
    /// Whether an effect of ordinary size would have been found.
    pub would_show: bool,
}

/// One channel.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[non_exhaustive]
pub struct ChannelReport {
    /// Whether the recording was held against the model in it.
    pub looked_at: bool,
    /// What is said of it.
    pub verdict: ChannelVerdict,
    /// Probability of as large a mismatch by chance.
    pub p_value: Option<f64>,
    /// Set where the simulations resolve no smaller one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub p_value_is: Option<Bound>,
    /// The covariates that the mismatch follows, the one that explains most first.
    pub located_by: Vec<String>,
    /// What could have been seen, the effects that show best (in units of their ordinary size) first.
    pub detectable: Vec<Detectable>,
    /// Why this is said, or why it was not looked at.
    pub reason: String,
    /// χ² per degree of freedom of frames and stars that took no part, with all that is found without them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub held_out_chi2_per_dof: Option<f64>,
    /// Degrees of freedom there.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub held_out_dof: Option<f64>,
}

impl ChannelReport {
    /// A channel that was not looked at.
    #[must_use]
    pub fn not_looked_at(reason: &str) -> Self {
        Self { reason: reason.to_owned(), ..Self::default() }
    }
}

/// All channels.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[non_exhaustive]
pub struct Channels {
    /// Places.
    pub astrometry: ChannelReport,
    /// Brightness.
    pub flux: ChannelReport,
    /// Width and elongation.
    pub shape: ChannelReport,
    /// Stamps.
    pub stamp: ChannelReport,
    /// Noise.
    pub noise: ChannelReport,
    /// Background.
    pub background: ChannelReport,
}

impl Channels {
    /// One of them.
    #[must_use]
    pub fn of(&self, channel: Channel) -> &ChannelReport {
        match channel {
            Channel::Astrometry => &self.astrometry,
            Channel::Flux => &self.flux,
            Channel::Shape => &self.shape,
            Channel::Stamp => &self.stamp,
            Channel::Noise => &self.noise,
            Channel::Background => &self.background,
        }
    }

    /// One of them, to be set.
    pub(super) fn of_mut(&mut self, channel: Channel) -> &mut ChannelReport {
        match channel {
            Channel::Astrometry => &mut self.astrometry,
            Channel::Flux => &mut self.flux,
            Channel::Shape => &mut self.shape,
            Channel::Stamp => &mut self.stamp,
            Channel::Noise => &mut self.noise,
            Channel::Background => &mut self.background,
        }
    }

    /// Those that were looked at.
    #[must_use]
    pub fn scope(&self) -> Vec<Channel> {
        Channel::ALL.into_iter().filter(|channel| self.of(*channel).looked_at).collect()
    }

    /// What the channels that were looked at say together.
    #[must_use]
    pub fn verdict(&self) -> Verdict {
        let any = |verdict: ChannelVerdict| Channel::ALL.into_iter().any(|channel| self.of(channel).verdict == verdict);
        if any(ChannelVerdict::Unexplained) {
            Verdict::Unexplained
        } else if any(ChannelVerdict::Explained) {
            Verdict::Explained
        } else if any(ChannelVerdict::Consistent) {
            Verdict::Consistent
        } else {
            Verdict::Undecided
        }
    }

    /// Every channel with its verdict, those that share one together: "positions: explained; brightness, …, background: not looked at".
    #[must_use]
    pub fn in_words(&self) -> String {
        let mut groups: Vec<(ChannelVerdict, Vec<&str>)> = Vec::new();
        for channel in Channel::ALL {
            let verdict = self.of(channel).verdict;
            match groups.iter_mut().find(|(known, _)| *known == verdict) {
                Some((_, names)) => names.push(channel.words()),
                None => groups.push((verdict, vec![channel.words()])),
            }
        }
        // What nobody looked at stands last.
        sort_by_key(&mut groups, |(verdict, _)| *verdict == ChannelVerdict::NotLookedAt);
        groups.iter().map(|(verdict, names)| format!("{}: {}", names.join(", "), verdict.words())).collect::<Vec<_>>().join("; ")
    }
}

/// A finding as one channel alone measures it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[non_exhaustive]
pub struct ChannelMeasure {
    /// Fall of χ² of this channel.
    pub delta_chi2: f64,
    /// The same on what took part in nothing; nothing where nothing was held out.
    pub held_out_delta_chi2: Option<f64>,
    /// χ² per degree of freedom of this channel there: without the finding, and with all that was found; noise and sizes are those of what did take part.
    #[serde(default)]
    pub held_out_chi2_per_dof: Option<[f64; 2]>,
    /// Degrees of freedom there.
    #[serde(default)]
    pub held_out_dof: Option<f64>,
    /// The finding's first parameter.
    pub amplitude: f64,
    /// Its standard error.
    pub sigma: f64,
}

/// A finding in every channel; `None` where the effect has no column there.
pub type ByChannel = BTreeMap<Channel, Option<ChannelMeasure>>;

#[cfg(test)]
mod tests {
    use super::ChannelVerdict::{Consistent, Explained, NotLookedAt, Undecided, Unexplained};
    use super::*;

    fn report(verdict: ChannelVerdict) -> ChannelReport {
        ChannelReport { looked_at: verdict != NotLookedAt, verdict, ..ChannelReport::default() }
    }

    #[test]
    fn the_verdict_is_of_what_was_looked_at() {
        let of = |astrometry, flux| Channels { astrometry: report(astrometry), flux: report(flux), ..Channels::default() };
        for (pair, expected) in [
            ((Consistent, NotLookedAt), Verdict::Consistent),
            ((Consistent, Undecided), Verdict::Consistent),
            ((Undecided, NotLookedAt), Verdict::Undecided),
            ((NotLookedAt, NotLookedAt), Verdict::Undecided),
            ((Explained, Undecided), Verdict::Explained),
            ((Explained, Unexplained), Verdict::Unexplained),
        ] {
            assert_eq!(of(pair.0, pair.1).verdict(), expected, "{pair:?}");
        }
        let channels = of(Explained, NotLookedAt);
        assert_eq!(channels.scope(), [Channel::Astrometry]);
        assert_eq!(channels.in_words(), "positions: explained; brightness, shape, stamps, noise, background: not looked at");
    }
}
