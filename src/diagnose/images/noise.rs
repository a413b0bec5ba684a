//! Rows of the pixels' noise, frame by frame, and what they tell: rows and columns, columns of two amplifiers, unequal pixels, a wrong gain.
//!
//! Errors of these numbers are known from the noise itself, so they are taken at their word.

use super::rows::{KNOWN_BEFOREHAND, Kind, Parameter, Question, Row, Rows, Shared, Shown};
use crate::diagnose::causes::GAIN_NOISE;
use crate::diagnose::channels::Channel;
use crate::effects::detector::{banding, bayer, dark_current, even_odd, prnu};
use crate::effects::{CentroidShift, pixel::PixelEffect};
use crate::pixel_statistics::{Estimate, FrameNoise, PatternPair, PixelStatistics, TransferPoint};

/// The numbers of the detector as the recording declares them.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DeclaredDetector {
    /// Electrons per count.
    pub gain_e_per_dn: Option<f64>,
    /// Counts of no light.
    pub bias_dn: Option<f64>,
    /// Read noise.
    pub read_noise_e: Option<f64>,
}

/// Stars that are not found add to the scatter of the sky by this share of it.
const CONFUSION: f64 = 0.01;

/// Levels that differ by less, over their mean, tell a gain and a read noise together alone.
const MIN_SPREAD: f64 = 0.15;
const DARK: &str = <dark_current::DarkCurrent as PixelEffect>::ID;
/// Of the variance of the offsets of rows (or columns) so much is seen in the pixels of a block: its plane takes an eighth.
const LINES_IN_BLOCK: f64 = 0.9;

/// One kind of numbers with the columns of what may make them.
struct NoiseKind {
    name: &'static str,
    /// Frame, value, standard error.
    numbers: Vec<(usize, f64, f64)>,
    common: Vec<Vec<f64>>,
    /// Of each effect the parameter's number and the column.
    columns: Vec<(&'static str, usize, Vec<f64>)>,
}

/// Adds the rows to those of stars. `place` gives a frame's place among all from its number.
pub(super) fn add_noise(rows: &mut Rows, pixels: &PixelStatistics, detector: &DeclaredDetector, place: impl Fn(usize) -> usize) {
    let kinds = [lines(pixels), parities(pixels), pattern(&pixels.fixed_pattern.pairs), transfer(pixels, detector)];
    let all: Vec<NoiseKind> = kinds.into_iter().flatten().filter(|kind| !kind.numbers.is_empty()).collect();
    let before = rows.len();
    let count: usize = all.iter().map(|kind| kind.numbers.len()).sum();
    for column in rows.questions.iter_mut().flat_map(|question| &mut question.columns) {
        column.resize(before + count, 0.0);
    }
    let mut star = rows.rows().map(|row| row.star + 1).max().unwrap_or(0);
    for (id, parameters, follows, sign) in EFFECTS {
        let mut columns = vec![vec![0.0; before + count]; parameters.len()];
        let mut at = before;
        for kind in &all {
            for (_, which, own) in kind.columns.iter().filter(|(own, _, _)| own == id) {
                columns[*which][at..at + own.len()].copy_from_slice(own);
            }
            at += kind.numbers.len();
        }
        if columns.iter().flatten().any(|value| *value != 0.0) {
            // A parameter without a column is not asked for.
            let asked: Vec<bool> = columns.iter().map(|column| column.iter().any(|value| *value != 0.0)).collect();
            let keep = |which: usize| asked[which];
            let parameters = parameters.iter().enumerate().filter(|(which, _)| keep(*which)).map(|(_, own)| *own).collect();
            let columns = columns.into_iter().enumerate().filter(|(which, _)| keep(*which)).map(|(_, own)| own).collect();
            rows.questions.push(Question { id, parameters, follows, columns, rank: 1, sign: *sign });
        }
    }
    for kind in all {
        let numbers = kind.numbers.iter().map(|(frame, value, sigma)| {
            star += 1;
            Row { value: *value, sigma: *sigma, frame: if *frame == KNOWN_BEFOREHAND { *frame } else { place(*frame) }, star, point: None }
        });
        rows.kinds.push(Kind {
            channel: Channel::Noise,
            name: kind.name,
            rows: numbers.collect(),
            per_frame: Vec::new(),
            common: kind.common,
            shared: Shared::No,
            is_scaled: false,
        });
    }
}

const fn parameter(name: &'static str, unit: &'static str, shown: Shown) -> Parameter {
    Parameter { name, unit, shown }
}

/// Id, parameters, what it follows, sign.
type Effect = (&'static str, &'static [Parameter], &'static str, Option<f64>);

/// Sizes that real detectors have, of the first column (a variance where the root is told), and where they are from.
const ORDINARY: &[(&str, f64, &str)] = &[
    (<even_odd::EvenOdd as CentroidShift>::ID, 0.005, "gains of two readout channels that differ by a percent (Janesick 2001)"),
    (<prnu::Prnu as PixelEffect>::ID, 1e-4, "0.2 to 2 % for CCD and CMOS sensors (EMVA 1288)"),
    (GAIN_NOISE, 0.05, "gains are declared to some percent"),
];

/// The size that real detectors have.
pub(super) fn ordinary(id: &str) -> Option<(f64, &'static str)> {
    ORDINARY.iter().find(|(own, ..)| *own == id).map(|(_, size, source)| (*size, *source))
}

/// The effects that have columns here. Variances are asked for, and their roots are told.
const EFFECTS: &[Effect] = &[
    (
        <banding::Banding as PixelEffect>::ID,
        &[parameter("row_sigma_dn", "DN", Shown::Root), parameter("column_sigma_dn", "DN", Shown::Root)],
        "row",
        Some(1.0),
    ),
    (<even_odd::EvenOdd as CentroidShift>::ID, &[parameter("relative", "", Shown::Same)], "pixel-parity-x", None),
    (
        <bayer::Bayer as CentroidShift>::ID,
        &[
            parameter("columns_relative", "", Shown::Same),
            parameter("rows_relative", "", Shown::Same),
            parameter("diagonals_relative", "", Shown::Same),
        ],
        "pixel-parity-x",
        None,
    ),
    (<prnu::Prnu as PixelEffect>::ID, &[parameter("relative", "", Shown::Root)], "fixed-pattern", Some(1.0)),
    (DARK, &[parameter("unequal_dn_per_s", "DN/s", Shown::Root)], "fixed-pattern", Some(1.0)),
    (GAIN_NOISE, &[parameter("gain_ratio", "", Shown::OneMore), parameter("variance_beside_dn2", "DN2", Shown::Same)], "level", None),
];

/// Numbers of the frames that have them.
fn numbers(pixels: &PixelStatistics, pick: impl Fn(&FrameNoise) -> Option<Estimate>) -> Vec<(usize, f64, f64)> {
    let told = |frame: &FrameNoise| pick(frame).map(|own| (frame.frame, own.value, own.sigma));
    pixels.by_frame.iter().filter_map(told).collect()
}

/// Variances of row and column offsets, one after the other.
fn lines(pixels: &PixelStatistics) -> Option<NoiseKind> {
    // Lines that are high and low in turns scatter too: that is told of odd and even ones.
    let less = |estimate: Option<Estimate>, frame: &FrameNoise, which: usize| {
        let in_turns = frame.parity_dn.map_or(0.0, |parity| parity[which].value.powi(2));
        estimate.map(|own| Estimate { value: own.value - in_turns, ..own })
    };
    let rows = numbers(pixels, |frame| less(frame.row_variance_dn2, frame, 1));
    let columns = numbers(pixels, |frame| less(frame.column_variance_dn2, frame, 0));
    let [of_rows, of_columns] = [1.0, 0.0].map(|own| {
        let column = vec![own; rows.len()].into_iter().chain(vec![1.0 - own; columns.len()]);
        column.collect::<Vec<f64>>()
    });
    let id = <banding::Banding as PixelEffect>::ID;
    let numbers: Vec<_> = rows.into_iter().chain(columns).collect();
    (!numbers.is_empty()).then(|| NoiseKind {
        name: "variance of rows and columns",
        numbers,
        common: Vec::new(),
        columns: vec![(id, 0, of_rows), (id, 1, of_columns)],
    })
}

/// Differences of odd and even columns, rows and diagonals: in proportion to the level.
fn parities(pixels: &PixelStatistics) -> Option<NoiseKind> {
    let told: Vec<(&FrameNoise, [Estimate; 3])> =
        pixels.by_frame.iter().filter_map(|frame| frame.parity_dn.map(|parity| (frame, parity))).collect();
    let numbers: Vec<(usize, f64, f64)> =
        (0..3).flat_map(|which| told.iter().map(move |(frame, parity)| (frame.frame, parity[which].value, parity[which].sigma))).collect();
    let column = |which: usize| -> Vec<f64> {
        (0..3).flat_map(|own| told.iter().map(move |(frame, _)| if own == which { frame.level_dn } else { 0.0 })).collect()
    };
    let (even_odd, mosaic) = (<even_odd::EvenOdd as CentroidShift>::ID, <bayer::Bayer as CentroidShift>::ID);
    (!numbers.is_empty()).then(|| NoiseKind {
        name: "odd against even",
        numbers,
        common: Vec::new(),
        columns: vec![(even_odd, 0, column(0)), (mosaic, 0, column(0)), (mosaic, 1, column(1)), (mosaic, 2, column(2))],
    })
}

/// Frame against frame.
fn pattern(pairs: &[PatternPair]) -> Option<NoiseKind> {
    let numbers: Vec<_> = pairs.iter().map(|pair| (pair.frames[0], pair.covariance.value, pair.covariance.sigma)).collect();
    let mut columns = vec![(DARK, 0, pairs.iter().map(|pair| pair.by_exposure).collect::<Vec<f64>>())];
    if let Some(by_light) = pairs.iter().map(|pair| pair.by_light).collect::<Option<Vec<f64>>>() {
        columns.push((<prnu::Prnu as PixelEffect>::ID, 0, by_light));
    }
    (!numbers.is_empty()).then(|| NoiseKind { name: "fixed pattern", numbers, common: Vec::new(), columns })
}

/// Standard deviation of levels over their mean.
fn spread(levels: impl Iterator<Item = f64> + Clone) -> f64 {
    let count = levels.clone().count().max(1) as f64;
    let mean = levels.clone().sum::<f64>() / count;
    (levels.map(|level| (level - mean).powi(2)).sum::<f64>() / count).sqrt() / mean.abs().max(f64::MIN_POSITIVE)
}

/// Variance of the sky less what gain, bias and read noise as declared make of its level. Without a bias or a read noise the intercept is free.
fn transfer(pixels: &PixelStatistics, detector: &DeclaredDetector) -> Option<NoiseKind> {
    let gain = detector.gain_e_per_dn?;
    let step = pixels.photon_transfer.as_ref()?.step_dn;
    let bias = detector.bias_dn.unwrap_or(0.0);
    let beside = detector.read_noise_e.map_or(0.0, |read_noise| (read_noise / gain).powi(2)) + step * step / 12.0;
    let is_told = detector.bias_dn.is_some() && detector.read_noise_e.is_some();
    let points: &[TransferPoint] = &pixels.transfer_points;
    let number = |point: &TransferPoint| {
        let expected = (point.level_dn - bias) / gain + beside;
        (point.frame, point.variance_dn2 - expected, point.sigma_dn2)
    };
    // The last number is no point: it says that the share of stars that were not found is zero within its error.
    let numbers = points.iter().map(number).chain([(KNOWN_BEFOREHAND, 0.0, CONFUSION)]).collect();
    let with = |last: f64, of: &dyn Fn(&TransferPoint) -> f64| -> Vec<f64> { points.iter().map(of).chain([last]).collect() };
    let one = with(0.0, &|_| 1.0);
    // A gain larger by a share makes so much less of the photons.
    let by_gain = with(0.0, &|point| -(point.level_dn - bias) / gain);
    let by_lines = with(0.0, &|_| LINES_IN_BLOCK);
    let banding = <banding::Banding as PixelEffect>::ID;
    let exposures: std::collections::BTreeMap<usize, f64> =
        pixels.by_frame.iter().map(|frame| (frame.frame, frame.exposure_s.unwrap_or(1.0))).collect();
    // Unequal dark current is a part of the scatter of the pixels of a block, as it is of what two frames share.
    let by_dark = with(0.0, &|point| exposures.get(&point.frame).map_or(1.0, |time| time * time));
    let mut columns = vec![(banding, 0, by_lines.clone()), (banding, 1, by_lines), (DARK, 0, by_dark)];
    // At one level alone gain, read noise and bias are one number.
    let is_gain_told = !is_told || spread(points.iter().map(|point| point.level_dn - bias)) > MIN_SPREAD;
    if is_gain_told {
        columns.push((GAIN_NOISE, 0, by_gain));
    }
    if detector.bias_dn.is_some() {
        columns.push((<prnu::Prnu as PixelEffect>::ID, 0, with(0.0, &|point| (point.level_dn - bias).powi(2))));
    }
    let mut common = vec![with(1.0, &|point| point.variance_dn2)];
    if is_told {
        columns.push((GAIN_NOISE, 1, one));
    } else {
        common.push(one);
    }
    (points.len() > 2).then_some(NoiseKind { name: "variance against level", numbers, common, columns })
}
