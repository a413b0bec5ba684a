//! What rows of noise are made of: kinds of numbers with their columns, the keys of these, and the numbers of the detector as they are declared.

use crate::effects::detector::brighter_fatter::BrighterFatter;
use crate::effects::detector::{dark_current, prnu};
use crate::effects::pixel::{PixelEffect, pass::PassHead};
use crate::pixel_statistics::PixelStatistics;

pub(super) const DARK: &str = <dark_current::DarkCurrent as PixelEffect>::ID;
pub(super) const DARK_OF_FRAMES: &str = "dark current of frames whose exposures are not all known";
pub(super) const PRNU: &str = <prnu::Prnu as PixelEffect>::ID;
pub(super) const ROWS: &str = "banding of rows";
pub(super) const COLUMNS: &str = "banding of columns";
pub(super) const SAME_ROWS: &str = "banding of rows that is the same in all frames";
pub(super) const SAME_COLUMNS: &str = "banding of columns that is the same in all frames";
pub(super) const BRIGHTER_FATTER: &str = <BrighterFatter as PassHead>::ID;

/// Key of the unequal dark current: per second where all exposures are known, else per frame.
pub(super) fn dark_key(pixels: &PixelStatistics) -> &'static str {
    if pixels.are_timed() { DARK } else { DARK_OF_FRAMES }
}

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

/// One kind of numbers with the columns of what may make them.
pub(super) struct NoiseKind {
    pub(super) name: &'static str,
    /// Frame, value, standard error.
    pub(super) numbers: Vec<(usize, f64, f64)>,
    pub(super) common: Vec<Vec<f64>>,
    /// Of each effect (by its key, else its id) the parameter's number and the column.
    pub(super) columns: Vec<(&'static str, usize, Vec<f64>)>,
}
