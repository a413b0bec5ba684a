//! The metrics by the names of the field: what each is, its unit, the kind of its statistics, and what answers must hold for it.

use super::verdict::SampleKind;

/// What of an answer a metric needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AnswerNeeds {
    /// An answer, whatever is in it.
    Answer,
    /// Attitudes.
    Attitude,
    /// Several frames of a place or several places: a design of attitudes.
    Design,
    /// Sequences of frames.
    Sequence,
    /// `centroids.csv`, or centroids in the answer.
    Centroids,
    /// Centroids with the numbers of their stars.
    Names,
    /// `camera.json`, or a camera in the answer.
    Camera,
    /// A diagnosis: of boresight alone.
    Diagnosis,
}

/// What a metric measures, without the word at its end that says which number of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quantity {
    /// A share of frames with right answers.
    Correct,
    /// With wrong answers.
    False,
    /// Without any.
    None,
    /// Frames until the first right answer of a sequence.
    FirstFrames,
    /// Frames until a right answer after one was lost.
    AgainFrames,
    /// Error of the boresight.
    CrossBoresight,
    /// Error of the roll.
    AboutBoresight,
    /// Errors of centroids.
    CentroidError,
    /// Error of centroids in step with the place within the pixel.
    SCurve,
    /// Stars that are found.
    Completeness,
    /// Centroids without a star.
    FalseStars,
    /// Names that are right.
    RightNames,
    /// Names that are wrong.
    WrongNames,
    /// Stars without a right name.
    MissedNames,
    /// Relative error of the focal length.
    FocalLength,
    /// Errors of a camera over their standard errors.
    Pulls,
    /// Error of pixel to direction.
    MapError,
    /// Nights of which a hidden effect is named.
    RightDiagnosis,
    /// Nights of which an effect is named that is not there.
    FalseDiagnosis,
    /// From handing over to the answer.
    Latency,
    /// Peak memory of a process.
    Memory,
    /// Frames at which the program crashed.
    Crashes,
    /// Frames without an answer in time.
    TimeOuts,
}

/// The word at the end of a metric's name.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Statistic {
    /// The number itself: a share, or the mean of counts.
    Plain,
    /// A quantile.
    Quantile(f64),
    /// The root mean square.
    Rms,
    /// The mean.
    Mean,
    /// The size of the mean error: ECSS' bias.
    Bias,
    /// The largest of the frames that were run.
    Max,
    /// Standard deviation over fields: ECSS' FOV spatial error.
    FovSpatial,
    /// Standard deviation over places within a pixel: ECSS' pixel spatial error.
    PixelSpatial,
    /// Standard deviation from exposure to exposure.
    TemporalNoise,
    /// Of stars of at least this signal-to-noise ratio.
    Snr(f64),
}

/// A metric.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Metric {
    /// What is measured.
    pub quantity: Quantity,
    /// Which number of it.
    pub statistic: Statistic,
    /// Its unit; empty: none.
    pub unit: &'static str,
    /// The kind of its statistics.
    pub kind: SampleKind,
    /// What answers must hold.
    pub needs: AnswerNeeds,
}

/// How the names of a group of metrics end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Ends {
    /// With nothing.
    Share,
    /// A share of stars, which may be those of a signal-to-noise ratio.
    Stars,
    /// Mean, quantiles, largest.
    Sizes,
    /// Those, root mean square and bias.
    Errors,
    /// The errors of ECSS.
    Ecss,
    /// Root mean square, largest.
    Rms,
    /// A mean of counts.
    Count,
    /// The largest alone.
    Largest,
}

/// A row of the list of metrics.
struct Row {
    name: &'static str,
    quantity: Quantity,
    ends: Ends,
    unit: &'static str,
    needs: AnswerNeeds,
    what: &'static str,
}

const fn row(name: &'static str, quantity: Quantity, ends: Ends, unit: &'static str, needs: AnswerNeeds, what: &'static str) -> Row {
    Row { name, quantity, ends, unit, needs, what }
}

const ROWS: &[Row] = &[
    row("acquisition.correct_rate", Quantity::Correct, Ends::Share, "", AnswerNeeds::Answer, "share of frames with a right attitude"),
    row("acquisition.false_rate", Quantity::False, Ends::Share, "", AnswerNeeds::Answer, "share of frames with an attitude that is wrong"),
    row("acquisition.none_rate", Quantity::None, Ends::Share, "", AnswerNeeds::Answer, "share of frames without an attitude"),
    row(
        "acquisition.first_frames",
        Quantity::FirstFrames,
        Ends::Sizes,
        "frames",
        AnswerNeeds::Sequence,
        "frames until the first right attitude of a sequence",
    ),
    row(
        "acquisition.again_frames",
        Quantity::AgainFrames,
        Ends::Sizes,
        "frames",
        AnswerNeeds::Sequence,
        "frames until a right attitude after one was lost",
    ),
    row(
        "attitude.cross_boresight_arcsec",
        Quantity::CrossBoresight,
        Ends::Errors,
        "arcsec",
        AnswerNeeds::Attitude,
        "angle between boresight and true boresight, of right answers",
    ),
    row(
        "attitude.about_boresight_arcsec",
        Quantity::AboutBoresight,
        Ends::Errors,
        "arcsec",
        AnswerNeeds::Attitude,
        "error of the roll, of right answers",
    ),
    row(
        "ecss.cross_boresight_arcsec",
        Quantity::CrossBoresight,
        Ends::Ecss,
        "arcsec",
        AnswerNeeds::Design,
        "the same split by its cause, one sigma of both axes together",
    ),
    row("ecss.about_boresight_arcsec", Quantity::AboutBoresight, Ends::Ecss, "arcsec", AnswerNeeds::Design, "the same of the roll"),
    row("centroids.error_px", Quantity::CentroidError, Ends::Rms, "px", AnswerNeeds::Centroids, "measured minus true position, 2-D"),
    row(
        "centroids.s_curve_px",
        Quantity::SCurve,
        Ends::Count,
        "px",
        AnswerNeeds::Centroids,
        "amplitude of the error in step with the place within the pixel",
    ),
    row(
        "centroids.completeness",
        Quantity::Completeness,
        Ends::Stars,
        "",
        AnswerNeeds::Centroids,
        "share of the stars that are found (signal-to-noise ratio of 10 or more)",
    ),
    row("centroids.false_per_frame", Quantity::FalseStars, Ends::Count, "", AnswerNeeds::Centroids, "centroids without a star near them"),
    row(
        "identification.right_rate",
        Quantity::RightNames,
        Ends::Stars,
        "",
        AnswerNeeds::Names,
        "share of the stars (signal-to-noise ratio of 10 or more) that are named rightly",
    ),
    row("identification.wrong_rate", Quantity::WrongNames, Ends::Share, "", AnswerNeeds::Names, "share of the named stars that are others"),
    row(
        "identification.missed_rate",
        Quantity::MissedNames,
        Ends::Stars,
        "",
        AnswerNeeds::Names,
        "share of the stars that are not named rightly",
    ),
    row(
        "calibration.focal_length_relative",
        Quantity::FocalLength,
        Ends::Errors,
        "",
        AnswerNeeds::Camera,
        "relative error of the focal length, one value a camera",
    ),
    row("calibration.pulls", Quantity::Pulls, Ends::Rms, "", AnswerNeeds::Camera, "errors of the camera over their stated standard errors"),
    row(
        "calibration.map_error_px",
        Quantity::MapError,
        Ends::Sizes,
        "px",
        AnswerNeeds::Camera,
        "error of pixel to direction over the frame, rms, after the best rotation",
    ),
    row(
        "diagnosis.right_name_rate",
        Quantity::RightDiagnosis,
        Ends::Share,
        "",
        AnswerNeeds::Diagnosis,
        "share of the nights of which all hidden effects are named",
    ),
    row(
        "diagnosis.false_name_rate",
        Quantity::FalseDiagnosis,
        Ends::Share,
        "",
        AnswerNeeds::Diagnosis,
        "share of the nights of which an effect is named that is not there",
    ),
    row("latency_s", Quantity::Latency, Ends::Sizes, "s", AnswerNeeds::Answer, "from handing over a frame to its answer"),
    row("memory_mib", Quantity::Memory, Ends::Largest, "MiB", AnswerNeeds::Answer, "peak resident memory of a process (Linux)"),
    row("crashes.rate", Quantity::Crashes, Ends::Share, "", AnswerNeeds::Answer, "share of frames at which the program ended by itself"),
    row("time_outs.rate", Quantity::TimeOuts, Ends::Share, "", AnswerNeeds::Answer, "share of frames without an answer in time"),
];

impl Ends {
    /// The words that may stand at the end, for messages.
    fn words(self) -> &'static [&'static str] {
        match self {
            Self::Share | Self::Count => &[],
            Self::Stars => &["snr20"],
            Self::Sizes => &["mean", "p50", "p95", "p99", "max"],
            Self::Errors => &["bias", "rms", "mean", "p50", "p95", "p99", "p997", "max"],
            Self::Ecss => &["bias", "fov_spatial", "pixel_spatial", "temporal_noise"],
            Self::Rms => &["rms", "bias"],
            Self::Largest => &["max"],
        }
    }

    fn statistic(self, word: Option<&str>) -> Option<(Statistic, SampleKind)> {
        let quantile = |word: &str| -> Option<f64> {
            let digits = word.strip_prefix('p').filter(|digits| (2..=6).contains(&digits.len()))?;
            let share = digits.parse::<u32>().ok()?;
            let share = f64::from(share) / 10_f64.powf(digits.len() as f64);
            (share > 0.0 && share < 1.0).then_some(share)
        };
        Some(match (self, word) {
            (Self::Share | Self::Stars, None) => (Statistic::Plain, SampleKind::Share),
            (Self::Count, None) => (Statistic::Plain, SampleKind::Mean),
            (Self::Stars, Some(word)) => {
                let snr = word.strip_prefix("snr")?.parse::<f64>().ok().filter(|snr| *snr >= 1.0)?;
                (Statistic::Snr(snr), SampleKind::Share)
            }
            (Self::Sizes | Self::Errors, Some("mean")) => (Statistic::Mean, SampleKind::Mean),
            (Self::Errors | Self::Rms, Some("rms")) => (Statistic::Rms, SampleKind::Square),
            (Self::Errors | Self::Ecss | Self::Rms, Some("bias")) => (Statistic::Bias, SampleKind::Mean),
            (Self::Ecss, Some("fov_spatial")) => (Statistic::FovSpatial, SampleKind::Square),
            (Self::Ecss, Some("pixel_spatial")) => (Statistic::PixelSpatial, SampleKind::Square),
            (Self::Ecss, Some("temporal_noise")) => (Statistic::TemporalNoise, SampleKind::Square),
            (Self::Sizes | Self::Errors | Self::Largest, Some("max")) => (Statistic::Max, SampleKind::Largest),
            (Self::Sizes | Self::Errors, Some(word)) => {
                let share = quantile(word)?;
                (Statistic::Quantile(share), SampleKind::Quantile(share))
            }
            _ => return None,
        })
    }
}

impl Metric {
    /// The metric of a name, or the sentence that says which was meant.
    pub fn find(name: &str) -> Result<Self, String> {
        let row = ROWS.iter().find(|row| name == row.name || name.strip_prefix(row.name).is_some_and(|rest| rest.starts_with('.')));
        let Some(row) = row else {
            let known: Vec<String> = names();
            let nearest = known.iter().min_by_key(|known| strsim::damerau_levenshtein(name, known));
            let meant = nearest.map_or_else(String::new, |nearest| format!("; did you mean {nearest}?"));
            return Err(format!("there is no metric {name}{meant}"));
        };
        let word = name.strip_prefix(row.name).and_then(|rest| rest.strip_prefix('.'));
        let Some((statistic, kind)) = row.ends.statistic(word) else {
            let words = row.ends.words();
            let ends = if words.is_empty() { "nothing more".to_owned() } else { format!("one of {}", words.join(", ")) };
            return Err(format!("the metric {} is followed by {ends}, not by {}", row.name, word.unwrap_or("nothing")));
        };
        Ok(Self { quantity: row.quantity, statistic, unit: row.unit, kind, needs: row.needs })
    }

    /// Whether each frame counts by itself, whatever it shares with others: what is of the program and not of the sky, and components, whose bounds know
    /// the design.
    pub(super) fn counts_frames_alone(&self) -> bool {
        matches!(self.quantity, Quantity::Crashes | Quantity::TimeOuts | Quantity::Latency | Quantity::Memory)
            || matches!(self.statistic, Statistic::FovSpatial | Statistic::PixelSpatial | Statistic::TemporalNoise | Statistic::Max)
    }
}

/// All names, each with the usual words at its end.
#[must_use]
pub fn names() -> Vec<String> {
    let of = |row: &Row| {
        let plain = row.ends.statistic(None).map(|_| row.name.to_owned());
        let more = row.ends.words().iter().map(|word| format!("{}.{word}", row.name)).collect::<Vec<_>>();
        plain.into_iter().chain(more)
    };
    ROWS.iter().flat_map(of).collect()
}

/// The list for people: name, words at its end, what it is.
#[must_use]
pub fn listed() -> Vec<[String; 3]> {
    ROWS.iter().map(|row| [row.name.to_owned(), row.ends.words().join(" "), row.what.to_owned()]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_listed_name_is_a_metric() {
        let all = names();
        assert!(all.len() > 50, "{}", all.len());
        for name in all {
            assert!(Metric::find(&name).is_ok(), "{name}");
        }
    }

    #[test]
    fn words_say_which_number_is_meant() {
        let kind = |name: &str| Metric::find(name).map(|metric| metric.kind);
        assert_eq!(kind("attitude.cross_boresight_arcsec.p9973"), Ok(SampleKind::Quantile(0.9973)));
        assert_eq!(kind("latency_s.p50"), Ok(SampleKind::Quantile(0.5)));
        assert_eq!(kind("memory_mib.max"), Ok(SampleKind::Largest));
        assert_eq!(kind("ecss.cross_boresight_arcsec.fov_spatial"), Ok(SampleKind::Square));
        let fault = |name: &str| Metric::find(name).unwrap_err();
        assert_eq!(fault("acquisition.corect_rate"), "there is no metric acquisition.corect_rate; did you mean acquisition.correct_rate?");
        assert!(fault("latency_s").contains("followed by one of mean, p50"));
        assert!(fault("acquisition.correct_rate.p99").contains("followed by nothing more"));
        assert!(fault("ecss.cross_boresight_arcsec.p99").contains("temporal_noise"));
    }
}
