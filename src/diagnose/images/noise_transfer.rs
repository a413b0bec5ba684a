//! Rows of the variance of sky pixels against their level, and what they tell: a wrong gain, a response that bends, and what else adds to the scatter.

use super::noise_kind::{BRIGHTER_FATTER, COLUMNS, DeclaredDetector, NoiseKind, PRNU, ROWS, SAME_COLUMNS, SAME_ROWS, dark_key};
use super::rows::KNOWN_BEFOREHAND;
use crate::diagnose::causes::GAIN_NOISE;
use crate::effects::ids;
use crate::pixel_statistics::{PixelStatistics, TransferPoint};

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
/// Of the variance of the offsets of rows (or columns) so much is seen in the pixels of a block: its plane takes an eighth.
const LINES_IN_BLOCK: f64 = 0.9;

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
        // It may be of stars all the same.
        return [0.0, CONFUSION.max(shared.abs() / SHARED_BY_NEIGHBOURS)];
    }
    let share = shared.max(0.0) / SHARED_BY_NEIGHBOURS;
    let sigma = 0.5 * neighbours.column.sigma.hypot(neighbours.row.sigma) / SHARED_BY_NEIGHBOURS;
    [share, (0.5 * share).hypot(sigma).hypot(MIN_CONFUSION_ERROR)]
}

/// Variance of the sky less what gain, bias and read noise as declared make of its level. Without a bias or a read noise the intercept is free.
pub(super) fn transfer(pixels: &PixelStatistics, detector: &DeclaredDetector) -> Option<NoiseKind> {
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
    let are_timed = pixels.are_timed();
    let exposures: std::collections::BTreeMap<usize, f64> =
        pixels.by_frame.iter().filter(|_| are_timed).filter_map(|frame| Some((frame.frame, frame.exposure_s?))).collect();
    // Unequal dark current is a part of the scatter of the pixels of a block, as it is of what two frames share.
    let by_dark = with(0.0, &|point| exposures.get(&point.frame).map_or(1.0, |time| time * time));
    let mut columns = vec![
        (ROWS, 0, by_lines.clone()),
        (COLUMNS, 0, by_lines.clone()),
        (SAME_ROWS, 0, by_lines.clone()),
        (SAME_COLUMNS, 0, by_lines),
        (dark_key(pixels), 0, by_dark),
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
