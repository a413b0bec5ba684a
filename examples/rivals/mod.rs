//! Methods that the calibrator is compared with. They see the same control points, and know the true noise where they need a scale.

mod adjust;
pub(crate) mod columns;
mod huber_pairs;
mod ransac;

use boresight::calibrate::trial::TrialNight;
use boresight::calibrate::{CalibrateOptions, Status, calibrate, calibrate_identifying_anew};
use boresight::camera::{Camera, PARAMETER_COUNT};
use boresight::catalog::Catalog;

/// What a method comes to.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Answer {
    pub(crate) camera: Camera,
    pub(crate) converged: bool,
}

/// A way from control points to a camera.
pub(crate) trait Calibrator: Sync {
    /// Its name in tables.
    fn name(&self) -> String;
    /// The camera; `None` if there is none. `sigma_px`: the true noise per axis. What is drawn by chance hangs on `seed` alone.
    fn solve(&self, night: &TrialNight, sigma_px: f64, seed: u64) -> Option<Answer>;
}

/// A method of the library.
pub(crate) struct Library {
    pub(crate) name: String,
    pub(crate) options: CalibrateOptions,
}

impl Calibrator for Library {
    fn name(&self) -> String {
        self.name.clone()
    }

    fn solve(&self, night: &TrialNight, _sigma_px: f64, _seed: u64) -> Option<Answer> {
        let result = calibrate(&night.control_points, &self.options).ok()?;
        Some(Answer { camera: result.camera, converged: result.status == Status::Converged })
    }
}

/// A method of the library that names the stars anew with the better camera.
pub(crate) struct IdentifiedAnew {
    pub(crate) name: String,
    pub(crate) options: CalibrateOptions,
}

impl Calibrator for IdentifiedAnew {
    fn name(&self) -> String {
        self.name.clone()
    }

    fn solve(&self, night: &TrialNight, _sigma_px: f64, _seed: u64) -> Option<Answer> {
        let result = calibrate_identifying_anew(&night.control_points, &[], Catalog::embedded(), None, &self.options).ok()?;
        Some(Answer { camera: result.camera, converged: result.status == Status::Converged })
    }
}

/// Least squares on pairs with Huber's weights.
pub(crate) struct HuberPairs;

impl Calibrator for HuberPairs {
    fn name(&self) -> String {
        "Huber on pairs".to_owned()
    }

    fn solve(&self, night: &TrialNight, _sigma_px: f64, _seed: u64) -> Option<Answer> {
        let frames = adjust::frames_of(&night.control_points, |_| true);
        let (camera, converged) = huber_pairs::solve(&frames, &night.control_points.nominal)?;
        Some(Answer { camera, converged })
    }
}

/// Random sample consensus.
pub(crate) struct Ransac;

impl Calibrator for Ransac {
    fn name(&self) -> String {
        "RANSAC".to_owned()
    }

    fn solve(&self, night: &TrialNight, sigma_px: f64, seed: u64) -> Option<Answer> {
        let frames = adjust::frames_of(&night.control_points, |_| true);
        let camera = ransac::solve(&frames, &night.control_points.nominal, sigma_px, seed)?;
        Some(Answer { camera, converged: true })
    }
}

/// Least squares at the level of stars with the wrong ones left out by the truth: what nobody without new names for them can beat.
pub(crate) struct Oracle;

impl Calibrator for Oracle {
    fn name(&self) -> String {
        "wrong stars known and left out".to_owned()
    }

    fn solve(&self, night: &TrialNight, _sigma_px: f64, _seed: u64) -> Option<Answer> {
        let frames = adjust::frames_of(&night.control_points, |index| !night.wrong[index]);
        let used: Vec<Vec<bool>> = frames.iter().map(|stars| vec![true; stars.len()]).collect();
        let adjusted = adjust::adjust(&frames, &used, &night.control_points.nominal, [true; PARAMETER_COUNT])?;
        Some(Answer { camera: adjusted.camera, converged: true })
    }
}
