//! A real dark frame of the camera in the place of read noise and dark current: counts less the bias, times the gain, are electrons that reading a
//! pixel adds, right before the converter. What the frame has (its noise, hot pixels, glow, banding) is on the rendered frame then, each once.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use super::{DetectorTable, EffectSetting, SceneError};
use crate::effects::ids;
use crate::frame::Frame;
use crate::recording::load_image;
use crate::statistics::{mad_sigma, median};

/// A window of a dark frame, ready.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct DarkFrame {
    /// Electrons, row by row.
    pub(crate) electrons: Arc<[f32]>,
    /// Standard deviation of a pixel, from the median absolute deviation.
    pub(crate) noise_e: f64,
    /// Median.
    pub(crate) level_e: f64,
}

/// Files that are kept in memory, since scenes of a dataset name the same ones again and again.
const KEPT: usize = 8;
/// Pixels that stand for the noise of all: every so many, a prime, so that neither rows nor columns are preferred.
const SAMPLED: usize = 20_011;
/// Effects that a dark frame has already.
const HELD: [&str; 3] = [ids::READ_NOISE, ids::DARK_CURRENT, ids::BANDING];

/// The last files that were read, the latest at the end, each with its length and time of change.
static FILES: Mutex<Vec<(PathBuf, Stamp, Arc<Frame>)>> = Mutex::new(Vec::new());

/// What tells that a file is another one.
type Stamp = (u64, Option<std::time::SystemTime>);

fn loaded(path: &Path) -> Result<Arc<Frame>, String> {
    let stamp = std::fs::metadata(path).map(|metadata| (metadata.len(), metadata.modified().ok())).unwrap_or_default();
    let is_it = |(known, of, _): &(PathBuf, Stamp, Arc<Frame>)| known == path && *of == stamp;
    if let Some((.., frame)) = FILES.lock().unwrap_or_else(PoisonError::into_inner).iter().find(|file| is_it(file)) {
        return Ok(Arc::clone(frame));
    }
    let frame = Arc::new(load_image(path).map_err(|problem| problem.to_string())?);
    let mut files = FILES.lock().unwrap_or_else(PoisonError::into_inner);
    files.retain(|file| file.0 != path);
    if files.len() >= KEPT {
        files.remove(0);
    }
    files.push((path.to_owned(), stamp, Arc::clone(&frame)));
    Ok(frame)
}

/// Reads the dark frame of a scene, if it has one; `size_px` is that of the frame.
pub(super) fn read(
    path: &str,
    detector: &DetectorTable,
    listed: &[EffectSetting],
    (size_px, is_binned): ([usize; 2], bool),
) -> Result<Option<DarkFrame>, SceneError> {
    let Some(file) = &detector.dark_frame else { return Ok(None) };
    let wrong =
        |problem: String| SceneError::Parse { path: path.to_owned(), message: format!("detector.dark_frame = {file:?}: {problem}") };
    if is_binned {
        return Err(wrong("joined pixels (camera.binning) have no dark frame; leave one of the two out".to_owned()));
    }
    if let Some(twice) = listed.iter().find(|setting| HELD.contains(&setting.id.as_str())) {
        return Err(wrong(format!("it has the effect {} already; leave the effect out", twice.id)));
    }
    let frame = loaded(&Path::new(path).parent().unwrap_or(Path::new("")).join(file)).map_err(wrong)?;
    let [width, height] = size_px;
    let [left, top] = detector.dark_frame_corner_px;
    if left + width > frame.width_px || top + height > frame.height_px {
        return Err(wrong(format!(
            "it has {} × {} px, too few for {width} × {height} from its pixel ({left}, {top}) on; give a larger one, or another dark_frame_corner_px",
            frame.width_px, frame.height_px
        )));
    }
    let electrons = |count: &f32| ((f64::from(*count) - detector.bias_dn) * detector.gain_e_per_dn) as f32;
    let rows = frame.pixels_dn.chunks_exact(frame.width_px).skip(top).take(height);
    let electrons: Arc<[f32]> = rows.flat_map(|row| row[left..left + width].iter().map(electrons)).collect();
    let step = (electrons.len() / SAMPLED).max(1);
    let sample: Vec<f64> = electrons.iter().step_by(step).map(|electrons| f64::from(*electrons)).collect();
    let (Some(level_e), Some(noise_e)) = (median(&sample), mad_sigma(&sample)) else { return Ok(None) };
    Ok(Some(DarkFrame { electrons, noise_e, level_e }))
}

impl DarkFrame {
    /// Whether each pixel stands out of the frame's noise.
    pub(crate) fn hot(&self) -> impl Iterator<Item = bool> + '_ {
        /// Of a normal distribution not one in 10¹² lies beyond.
        const SIGMAS: f64 = 7.0;
        // What is rounded to whole counts may have no spread at all.
        let above_e = (self.level_e + SIGMAS * self.noise_e.max(1.0)) as f32;
        self.electrons.iter().map(move |electrons| *electrons > above_e)
    }
}
