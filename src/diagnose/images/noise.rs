//! Rows of the pixels' noise, frame by frame, and what they tell: rows and columns, columns of two amplifiers, unequal pixels, a wrong gain.
//!
//! Errors of these numbers are known from the noise itself, so they are taken at their word.

use super::noise_kind::{
    BRIGHTER_FATTER, COLUMNS, DARK, DARK_OF_FRAMES, DeclaredDetector, NoiseKind, PRNU, ROWS, SAME_COLUMNS, SAME_ROWS, dark_key,
};
use super::noise_transfer::transfer;
use super::rows::{KNOWN_BEFOREHAND, Kind, Parameter, Question, Row, Rows, Shared, Shown};
use crate::diagnose::causes::GAIN_NOISE;
use crate::diagnose::channels::Channel;
use crate::effects::detector::{banding, bayer, even_odd};
use crate::effects::pixel::PixelEffect;
use crate::effects::{CentroidShift, ids};
use crate::pixel_statistics::{Estimate, FrameNoise, KEPT_BY_PLANE, LinePair, PixelStatistics};

const BANDING: &str = <banding::Banding as PixelEffect>::ID;
const EVEN_ODD: &str = <even_odd::EvenOdd as CentroidShift>::ID;
const BAYER: &str = <bayer::Bayer as CentroidShift>::ID;

/// Adds the rows to those of stars. `place` gives a frame's place among all from its number.
pub(super) fn add_noise(rows: &mut Rows, pixels: &PixelStatistics, detector: &DeclaredDetector, place: impl Fn(usize) -> usize) {
    let kinds = [lines(pixels), parities(pixels, detector.bias_dn), pattern(pixels), transfer(pixels, detector)];
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

/// How the σ of offsets of lines and of pixels is told. A frame's own covariance of two halves holds half of the scatter of its draws in its error.
fn shown(key: &str, pixels: &PixelStatistics) -> Option<Shown> {
    // A block's plane leaves fewer lines independent: of columns, of rows.
    let lines = |which: usize| pixels.sky.first().map(|sky| (KEPT_BY_PLANE * sky.size_px[which] as f64) as u32);
    let in_frames = |which: usize, pick: fn(&FrameNoise) -> Option<Estimate>| {
        let frames = u32::try_from(pixels.by_frame.iter().filter_map(pick).count()).unwrap_or(u32::MAX);
        lines(which).map(|lines| Shown::RootOfDraws(lines.saturating_mul(frames).saturating_mul(2)))
    };
    match key {
        ROWS => in_frames(1, |frame| frame.row_variance_dn2),
        COLUMNS => in_frames(0, |frame| frame.column_variance_dn2),
        SAME_ROWS => lines(1).map(Shown::RootOfSharedDraws),
        SAME_COLUMNS => lines(0).map(Shown::RootOfSharedDraws),
        PRNU | DARK | DARK_OF_FRAMES => Some(Shown::RootOfSharedDraws(u32::try_from(pixels.fixed_pattern.pixels).unwrap_or(u32::MAX))),
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
    (DARK_OF_FRAMES, DARK, &[parameter("unequal_dn_per_frame", "DN", Shown::Root)], "fixed-pattern", Some(1.0)),
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
    let over_frames = |which: usize, of: &dyn Fn(&FrameNoise) -> f64| -> Vec<f64> {
        (0..3).flat_map(|own| told.iter().map(move |(frame, _)| if own == which { of(frame) } else { 0.0 })).collect()
    };
    let by_chance = parity_by_chance(pixels);
    // The last two numbers are no measurements: they say that what is there by chance is 0 within its standard error.
    let chance = |which: usize| -> Vec<f64> {
        let known = [0, 1].map(|own| if own == which { 1.0 } else { 0.0 });
        over_frames(which, &|_| by_chance[which]).into_iter().chain(known).collect()
    };
    let column = |which: usize| -> Vec<f64> {
        over_frames(which, &|frame| bias_dn.unwrap_or(0.0) - frame.level_dn).into_iter().chain([0.0; 2]).collect()
    };
    let is_known = !numbers.is_empty();
    let numbers = numbers.into_iter().chain([(KNOWN_BEFOREHAND, 0.0, 1.0); 2]).collect();
    is_known.then(|| NoiseKind {
        name: "odd against even",
        numbers,
        common: vec![chance(0), chance(1)],
        columns: vec![(EVEN_ODD, 0, column(0)), (BAYER, 0, column(0)), (BAYER, 1, column(1)), (BAYER, 2, column(2))],
    })
}

/// Half the difference, DN, that odd and even columns, and rows, have by chance, where lines are offset alike in all frames: it is the same in all.
fn parity_by_chance(pixels: &PixelStatistics) -> [f64; 2] {
    let Some(lines) = pixels.sky.first().map(|sky| sky.size_px) else { return [0.0; 2] };
    let shared = |pick: fn(&LinePair) -> Option<Estimate>| {
        Estimate::pooled(&pixels.line_pairs.iter().filter_map(pick).collect::<Vec<_>>()).map_or(0.0, |own| own.value.max(0.0))
    };
    let variance = [shared(|pair| pair.columns), shared(|pair| pair.rows)];
    [0, 1].map(|which| (variance[which] / lines[which].max(1) as f64).sqrt())
}

/// Frame against frame.
fn pattern(pixels: &PixelStatistics) -> Option<NoiseKind> {
    let pairs = &pixels.fixed_pattern.pairs;
    let numbers: Vec<_> = pairs.iter().map(|pair| (pair.frames[0], pair.covariance.value, pair.covariance.sigma)).collect();
    let mut columns = vec![(dark_key(pixels), 0, pairs.iter().map(|pair| pair.by_exposure).collect::<Vec<f64>>())];
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
