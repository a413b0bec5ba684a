//! Rows of the pixels' noise, frame by frame, and what they tell: rows and columns, columns of two amplifiers, unequal pixels, a wrong gain.
//!
//! Errors of these numbers are known from the noise itself, so they are taken at their word.

use super::rows::{KNOWN_BEFOREHAND, Kind, Parameter, Question, Row, Rows, Shared, Shown};
use crate::diagnose::causes::GAIN_NOISE;
use crate::diagnose::channels::Channel;
use crate::effects::detector::brighter_fatter::BrighterFatter;
use crate::effects::detector::{banding, bayer, dark_current, even_odd, prnu};
use crate::effects::pixel::{PixelEffect, pass::PassHead};
use crate::effects::{CentroidShift, ids};
use crate::pixel_statistics::{Estimate, FrameNoise, LinePair, PatternPair, PixelStatistics, TransferPoint};

/// The numbers of the detector as the recording declares them.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DeclaredDetector {
    /// Electrons per count.
    pub gain_e_per_dn: Option<f64>,
    /// Counts of no light.
    pub bias_dn: Option<f64>,
    /// Read noise.
    pub read_noise_e: Option<f64>,
    /// Counts of a full pixel.
    pub saturation_dn: Option<f64>,
}

impl From<&crate::recording::CameraInfo> for DeclaredDetector {
    fn from(camera: &crate::recording::CameraInfo) -> Self {
        Self {
            gain_e_per_dn: camera.gain_e_per_dn,
            bias_dn: camera.bias_dn,
            read_noise_e: camera.read_noise_e,
            saturation_dn: camera.saturation_dn,
        }
    }
}

/// Stars that are not found add to the scatter of the sky by this share of it, where neighbours do not tell,
const CONFUSION: f64 = 0.01;
/// and with this error at least where they do: clipping and smooth structure of the sky are of that order.
const MIN_CONFUSION_ERROR: f64 = 0.003;
/// Of the scatter by stars so much is shared by neighbouring pixels: exp(−1/(4(σ² + 1/12))) of images of σ = 0.65 px.
const SHARED_BY_NEIGHBOURS: f64 = 0.6;
/// Neighbours that share more of their noise do so for other reasons.
const MAX_SHARED: f64 = 0.02;

/// Levels that differ by less, over their mean, tell a gain and a read noise together alone.
const MIN_SPREAD: f64 = 0.15;
const DARK: &str = <dark_current::DarkCurrent as PixelEffect>::ID;
const BANDING: &str = <banding::Banding as PixelEffect>::ID;
const EVEN_ODD: &str = <even_odd::EvenOdd as CentroidShift>::ID;
const BAYER: &str = <bayer::Bayer as CentroidShift>::ID;
const PRNU: &str = <prnu::Prnu as PixelEffect>::ID;
const ROWS: &str = "banding of rows";
const COLUMNS: &str = "banding of columns";
const SAME_ROWS: &str = "banding of rows that is the same in all frames";
const SAME_COLUMNS: &str = "banding of columns that is the same in all frames";
const BRIGHTER_FATTER: &str = <BrighterFatter as PassHead>::ID;
/// Of the variance of the offsets of rows (or columns) so much is seen in the pixels of a block: its plane takes an eighth.
const LINES_IN_BLOCK: f64 = 0.9;

/// One kind of numbers with the columns of what may make them.
struct NoiseKind {
    name: &'static str,
    /// Frame, value, standard error.
    numbers: Vec<(usize, f64, f64)>,
    common: Vec<Vec<f64>>,
    /// Of each effect (by its key, else its id) the parameter's number and the column.
    columns: Vec<(&'static str, usize, Vec<f64>)>,
}

/// Adds the rows to those of stars. `place` gives a frame's place among all from its number.
pub(super) fn add_noise(rows: &mut Rows, pixels: &PixelStatistics, detector: &DeclaredDetector, place: impl Fn(usize) -> usize) {
    let kinds = [lines(pixels), parities(pixels, detector.bias_dn), pattern(&pixels.fixed_pattern.pairs), transfer(pixels, detector)];
    let all: Vec<NoiseKind> = kinds.into_iter().flatten().filter(|kind| !kind.numbers.is_empty()).collect();
    let before = rows.len();
    let count: usize = all.iter().map(|kind| kind.numbers.len()).sum();
    for column in rows.questions.iter_mut().flat_map(|question| &mut question.columns) {
        column.resize(before + count, 0.0);
    }
    let mut star = rows.rows().map(|row| row.star + 1).max().unwrap_or(0);
    for (key, id, parameters, follows, sign) in EFFECTS {
        let columns = columns_of(&all, key, parameters.len(), before);
        if columns.iter().flatten().any(|value| *value != 0.0) {
            // A parameter without a column is not asked for.
            let asked: Vec<bool> = columns.iter().map(|column| column.iter().any(|value| *value != 0.0)).collect();
            let keep = |which: usize| asked[which];
            let told = |own: &Parameter| Parameter { shown: shown(key, pixels).unwrap_or(own.shown), ..*own };
            let parameters = parameters.iter().enumerate().filter(|(which, _)| keep(*which)).map(|(_, own)| told(own)).collect();
            let columns = columns.into_iter().enumerate().filter(|(which, _)| keep(*which)).map(|(_, own)| own).collect();
            rows.questions.push(Question { id, parameters, follows, columns, rank: 1, sign: *sign, is_part: false, products_of: &[] });
        }
    }
    join_stars(rows, &all, before);
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

/// How the σ of offsets of lines is told. A frame's own covariance of two halves holds half of the scatter of its draws in its error.
fn shown(key: &str, pixels: &PixelStatistics) -> Option<Shown> {
    let [columns, rows] = pixels.sky.first()?.size_px.map(|lines| u32::try_from(lines).unwrap_or(u32::MAX));
    let frames = u32::try_from(pixels.by_frame.len()).unwrap_or(u32::MAX);
    match key {
        ROWS => Some(Shown::RootOfDraws(rows.saturating_mul(frames).saturating_mul(2))),
        COLUMNS => Some(Shown::RootOfDraws(columns.saturating_mul(frames).saturating_mul(2))),
        SAME_ROWS => Some(Shown::RootOfSharedDraws(rows)),
        SAME_COLUMNS => Some(Shown::RootOfSharedDraws(columns)),
        _ => None,
    }
}

/// Columns over all rows of an effect's parameters; zero before those of the noise.
fn columns_of(all: &[NoiseKind], key: &str, parameters: usize, before: usize) -> Vec<Vec<f64>> {
    let count: usize = all.iter().map(|kind| kind.numbers.len()).sum();
    let mut columns = vec![vec![0.0; before + count]; parameters];
    let mut at = before;
    for kind in all {
        for (_, which, own) in kind.columns.iter().filter(|(own, _, _)| *own == key) {
            columns[*which][at..at + own.len()].copy_from_slice(own);
        }
        at += kind.numbers.len();
    }
    columns
}

/// What stars ask for and the noise tells too.
fn join_stars(rows: &mut Rows, all: &[NoiseKind], before: usize) {
    for question in rows.questions.iter_mut().filter(|question| [ids::NONLINEARITY, BRIGHTER_FATTER].contains(&question.id)) {
        let Some(own) = columns_of(all, question.id, 1, before).pop().filter(|own| own.iter().any(|value| *value != 0.0)) else { continue };
        if question.id == ids::NONLINEARITY {
            question.columns[0].iter_mut().zip(own).for_each(|(column, value)| *column += value);
        } else {
            // How the two go together hangs on how far the charge reaches: the noise has a size of its own.
            question.columns.push(own);
            question.parameters.push(parameter("variance_lost_at_full", "", Shown::Same));
        }
    }
}

const fn parameter(name: &'static str, unit: &'static str, shown: Shown) -> Parameter {
    Parameter { name, unit, shown }
}

/// Key of its columns, id, parameters, what it follows, sign.
type Effect = (&'static str, &'static str, &'static [Parameter], &'static str, Option<f64>);

/// Sizes that real detectors have, of the first column (a variance where the root is told), and where they are from.
const ORDINARY: &[(&str, f64, &str)] = &[
    (EVEN_ODD, 0.005, "gains of two readout channels that differ by a percent (Janesick 2001)"),
    (PRNU, 1e-4, "0.2 to 2 % for CCD and CMOS sensors (EMVA 1288)"),
    (GAIN_NOISE, 0.05, "gains are declared to some percent"),
];

/// The size that real detectors have.
pub(super) fn ordinary(id: &str) -> Option<(f64, &'static str)> {
    ORDINARY.iter().find(|(own, ..)| *own == id).map(|(_, size, source)| (*size, *source))
}

/// The effects that have columns here. Variances are asked for, and their roots are told.
const EFFECTS: &[Effect] = &[
    (ROWS, BANDING, &[parameter("row_sigma_dn", "DN", Shown::Root)], "row", Some(1.0)),
    (COLUMNS, BANDING, &[parameter("column_sigma_dn", "DN", Shown::Root)], "x", Some(1.0)),
    (SAME_ROWS, BANDING, &[parameter("row_sigma_dn", "DN", Shown::Root)], "row", Some(1.0)),
    (SAME_COLUMNS, BANDING, &[parameter("column_sigma_dn", "DN", Shown::Root)], "x", Some(1.0)),
    (EVEN_ODD, EVEN_ODD, &[parameter("relative", "", Shown::Same)], "pixel-parity-x", None),
    (
        BAYER,
        BAYER,
        &[
            parameter("columns_relative", "", Shown::Same),
            parameter("rows_relative", "", Shown::Same),
            parameter("diagonals_relative", "", Shown::Same),
        ],
        "pixel-parity-x",
        None,
    ),
    (PRNU, PRNU, &[parameter("relative", "", Shown::Root)], "fixed-pattern", Some(1.0)),
    (DARK, DARK, &[parameter("unequal_dn_per_s", "DN/s", Shown::Root)], "fixed-pattern", Some(1.0)),
    (
        GAIN_NOISE,
        GAIN_NOISE,
        &[parameter("gain_ratio", "", Shown::OneMore), parameter("variance_beside_dn2", "DN2", Shown::Same)],
        "level",
        None,
    ),
];

/// Numbers of the frames that have them.
fn numbers(pixels: &PixelStatistics, pick: impl Fn(&FrameNoise) -> Option<Estimate>) -> Vec<(usize, f64, f64)> {
    let told = |frame: &FrameNoise| pick(frame).map(|own| (frame.frame, own.value, own.sigma));
    pixels.by_frame.iter().filter_map(told).collect()
}

/// Variances of row and column offsets: those of each frame, one after the other, and those that two frames share. Of lines that are offset anew in
/// every frame two share nothing; of lines that are always the same two share as much as one has. The numbers of one frame and of pairs are products of
/// different noise, and independent.
fn lines(pixels: &PixelStatistics) -> Option<NoiseKind> {
    let rows = numbers(pixels, |frame| frame.row_variance_dn2);
    let columns = numbers(pixels, |frame| frame.column_variance_dn2);
    let shared = |pick: fn(&LinePair) -> Option<Estimate>| -> Vec<(usize, f64, f64)> {
        pixels.line_pairs.iter().filter_map(|pair| pick(pair).map(|own| (pair.frames[0], own.value, own.sigma))).collect()
    };
    let groups = [rows, columns, shared(|pair| pair.rows), shared(|pair| pair.columns)];
    // Which groups an offset shows in.
    let column = |shows: [bool; 4]| -> Vec<f64> {
        groups.iter().zip(shows).flat_map(|(group, shows)| vec![f64::from(u8::from(shows)); group.len()]).collect()
    };
    let mut columns = vec![(ROWS, 0, column([true, false, false, false])), (COLUMNS, 0, column([false, true, false, false]))];
    if !pixels.line_pairs.is_empty() {
        columns.push((SAME_ROWS, 0, column([true, false, true, false])));
        columns.push((SAME_COLUMNS, 0, column([false, true, false, true])));
    }
    let numbers: Vec<_> = groups.into_iter().flatten().collect();
    (!numbers.is_empty()).then(|| NoiseKind { name: "variance of rows and columns", numbers, common: Vec::new(), columns })
}

/// Half the differences of odd and even columns, rows and diagonals: in proportion to the light, with the sign of the page of even-odd, by which even
/// columns count more. `bias_dn`: counts of no light, where they are known.
fn parities(pixels: &PixelStatistics, bias_dn: Option<f64>) -> Option<NoiseKind> {
    let told: Vec<(&FrameNoise, [Estimate; 3])> =
        pixels.by_frame.iter().filter_map(|frame| frame.parity_dn.map(|parity| (frame, parity))).collect();
    let numbers: Vec<(usize, f64, f64)> =
        (0..3).flat_map(|which| told.iter().map(move |(frame, parity)| (frame.frame, parity[which].value, parity[which].sigma))).collect();
    let column = |which: usize| -> Vec<f64> {
        (0..3)
            .flat_map(|own| told.iter().map(move |(frame, _)| if own == which { bias_dn.unwrap_or(0.0) - frame.level_dn } else { 0.0 }))
            .collect()
    };
    (!numbers.is_empty()).then(|| NoiseKind {
        name: "odd against even",
        numbers,
        common: Vec::new(),
        columns: vec![(EVEN_ODD, 0, column(0)), (BAYER, 0, column(0)), (BAYER, 1, column(1)), (BAYER, 2, column(2))],
    })
}

/// Frame against frame.
fn pattern(pairs: &[PatternPair]) -> Option<NoiseKind> {
    let numbers: Vec<_> = pairs.iter().map(|pair| (pair.frames[0], pair.covariance.value, pair.covariance.sigma)).collect();
    let mut columns = vec![(DARK, 0, pairs.iter().map(|pair| pair.by_exposure).collect::<Vec<f64>>())];
    if let Some(by_light) = pairs.iter().map(|pair| pair.by_light).collect::<Option<Vec<f64>>>() {
        columns.push((PRNU, 0, by_light));
    }
    (!numbers.is_empty()).then(|| NoiseKind { name: "fixed pattern", numbers, common: Vec::new(), columns })
}

/// Of what no frames are held against each other for, why not.
pub(super) fn unasked_pattern(rows: &Rows, pixels: &PixelStatistics) -> Vec<(&'static str, String)> {
    if !pixels.fixed_pattern.pairs.is_empty() {
        return Vec::new();
    }
    let reason = "it needs frames of three different pointings, of one size, that are compared pixel by pixel";
    let is_asked = |id: &str| rows.questions.iter().any(|question| question.id == id);
    [PRNU, DARK].into_iter().filter(|id| !is_asked(id)).map(|id| (id, reason.to_owned())).collect()
}

/// Standard deviation of levels over their mean.
fn spread(levels: impl Iterator<Item = f64> + Clone) -> f64 {
    let count = levels.clone().count().max(1) as f64;
    let mean = levels.clone().sum::<f64>() / count;
    (levels.map(|level| (level - mean).powi(2)).sum::<f64>() / count).sqrt() / mean.abs().max(f64::MIN_POSITIVE)
}

/// The share of the sky's scatter that is of stars that were not found, with its error: white noise has none in common from pixel to pixel.
fn confusion(pixels: &PixelStatistics) -> [f64; 2] {
    let Some(neighbours) = &pixels.neighbours else { return [0.0, CONFUSION] };
    let shared = 0.5 * (neighbours.column.value + neighbours.row.value);
    if shared.abs() > MAX_SHARED {
        return [0.0, CONFUSION];
    }
    let share = shared.max(0.0) / SHARED_BY_NEIGHBOURS;
    let sigma = 0.5 * neighbours.column.sigma.hypot(neighbours.row.sigma) / SHARED_BY_NEIGHBOURS;
    [share, (0.5 * share).hypot(sigma).hypot(MIN_CONFUSION_ERROR)]
}

/// Variance of the sky less what gain, bias and read noise as declared make of its level. Without a bias or a read noise the intercept is free.
fn transfer(pixels: &PixelStatistics, detector: &DeclaredDetector) -> Option<NoiseKind> {
    let gain = detector.gain_e_per_dn?;
    let step = pixels.photon_transfer.as_ref()?.step_dn;
    let bias = detector.bias_dn.unwrap_or(0.0);
    let beside = detector.read_noise_e.map_or(0.0, |read_noise| (read_noise / gain).powi(2)) + step * step / 12.0;
    let is_told = detector.bias_dn.is_some() && detector.read_noise_e.is_some();
    // Of less noise the variance hangs on the place of the level between two codes, and of processed frames on what was done to them.
    if pixels.altered_noise().is_some() {
        return None;
    }
    let points: Vec<&TransferPoint> = pixels.transfer_points.iter().filter(|point| point.is_wider_than_rounding(step)).collect();
    let number = |point: &&TransferPoint| {
        let expected = (point.level_dn - bias) / gain + beside;
        (point.frame, point.variance_dn2 - expected, point.sigma_dn2)
    };
    // The last number is no point: it says what the share of stars that were not found is, within its error.
    let [share, error] = confusion(pixels);
    let numbers = points.iter().map(number).chain([(KNOWN_BEFOREHAND, share, error)]).collect();
    let with = |last: f64, of: &dyn Fn(&TransferPoint) -> f64| -> Vec<f64> { points.iter().map(|point| of(point)).chain([last]).collect() };
    let one = with(0.0, &|_| 1.0);
    // A gain larger by a share makes so much less of the photons.
    let by_gain = with(0.0, &|point| -(point.level_dn - bias) / gain);
    let by_lines = with(0.0, &|_| LINES_IN_BLOCK);
    // Where a single exposure is not known all count as frames, as they do for the pattern.
    let exposures: std::collections::BTreeMap<usize, f64> =
        pixels.by_frame.iter().map(|frame| Some((frame.frame, frame.exposure_s?))).collect::<Option<_>>().unwrap_or_default();
    // Unequal dark current is a part of the scatter of the pixels of a block, as it is of what two frames share.
    let by_dark = with(0.0, &|point| exposures.get(&point.frame).map_or(1.0, |time| time * time));
    let mut columns = vec![
        (ROWS, 0, by_lines.clone()),
        (COLUMNS, 0, by_lines.clone()),
        (SAME_ROWS, 0, by_lines.clone()),
        (SAME_COLUMNS, 0, by_lines),
        (DARK, 0, by_dark),
    ];
    // At one level alone gain, read noise and bias are one number.
    let is_gain_told = !is_told || spread(points.iter().map(|point| point.level_dn - bias)) > MIN_SPREAD;
    if is_gain_told {
        columns.push((GAIN_NOISE, 0, by_gain));
    }
    if let Some(full_dn) = detector.saturation_dn.map(|full| full - bias).filter(|full| detector.bias_dn.is_some() && *full > 0.0) {
        // Of N electrons in a pixel of W a response N(1 − αN/W) leaves the variance N(1 − 4αN/W), and the level itself 1 − αN/W of it.
        let by_response = with(0.0, &|point| -3.0 * (point.level_dn - bias).powi(2) / (gain * full_dn));
        // Charge that is pushed into neighbours takes the part βN/W of the variance with it (Antilogus et al. 2014).
        let by_neighbours = with(0.0, &|point| -(point.level_dn - bias).powi(2) / (gain * full_dn));
        columns.extend([(ids::NONLINEARITY, 0, by_response), (BRIGHTER_FATTER, 0, by_neighbours)]);
    }
    if detector.bias_dn.is_some() {
        columns.push((PRNU, 0, with(0.0, &|point| (point.level_dn - bias).powi(2))));
    }
    let mut common = vec![with(1.0, &|point| point.variance_dn2)];
    if is_told {
        columns.push((GAIN_NOISE, 1, one));
    } else {
        common.push(one);
    }
    (points.len() > 2).then_some(NoiseKind { name: "variance against level", numbers, common, columns })
}
