//! Painted recordings: in the program's own form, on disk and straight in memory with the same content, and diagnosed as
//! `boresight diagnose` does it: stars found, measured and identified without being told anything.

use std::path::{Path, PathBuf};
use std::time::Instant;

use serde::{Deserialize, Serialize};

use super::generate::{Canvas, Concealed, Family, Lists, PaintedStar, concealed};
use super::run::{answer_of_lists, shortened};
use super::{Answer, BlindError, recording};
use crate::camera::Physics;
use crate::catalog::Catalog;
use crate::diagnose::{DiagnoseOptions, diagnose};
use crate::frame::Frame;
use crate::identify::{ControlPoint, IdentifyOptions};
use crate::pipeline::{
    DiagnosisInput, DiagnosisRequest, MeasureOptions, PipelineError, SkyChoice, control_points, diagnosis_request, identify_frames,
    measure_frames,
};
use crate::recording::{FitsHeaders, Form, FrameEntry, FrameSize, Recording, write_fits_u16, write_manifest};

/// A star image further than this from where the star was painted is that of another.
const SAME_STAR_PX: f64 = 3.0;
/// The top of the converter's range.
const SATURATION_DN: f64 = 65_535.0;

/// Errors of measured centres over the declared ones, both axes together.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Centres {
    /// How many.
    pub count: usize,
    /// Sum.
    pub sum: f64,
    /// Sum of squares.
    pub square: f64,
    /// How many lie within one declared standard error.
    pub within_1: usize,
    /// How many lie beyond four.
    pub beyond_4: usize,
}

impl Centres {
    fn add(&mut self, pull: f64) {
        self.count += 1;
        self.sum += pull;
        self.square += pull * pull;
        self.within_1 += usize::from(pull.abs() < 1.0);
        self.beyond_4 += usize::from(pull.abs() > 4.0);
    }
}

/// What an answer about frames of pixels has besides: the answer about the same stars as star lists, and how the way to the control points
/// went.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PixelAnswer {
    /// The answer about the same world, the same thing hidden, with normal errors in the place of pixels.
    pub lists: Answer,
    /// Frames identified.
    pub frames_identified: usize,
    /// Frames.
    pub frames: usize,
    /// Stars painted alone: no other shines into their images.
    pub stars_painted: usize,
    /// Of these the stars that the diagnosis used under their right names.
    pub stars_right: usize,
    /// Star images that it used under the name of a star that is not there.
    pub stars_wrong: usize,
    /// Errors of the measured centres.
    pub centres: Centres,
    /// Wall time of painting, measuring, identifying, and diagnosing (the baseline included), s.
    pub seconds_by_step: [f64; 4],
}

/// The recording, as it would be read back from its folder.
#[must_use]
pub fn pixel_recording(lists: &Lists, canvas: &Canvas) -> Recording {
    let mut recording = recording(lists);
    recording.form = Form::Manifest;
    recording.stars = None;
    let camera = &mut recording.camera;
    camera.gain_e_per_dn = Some(canvas.gain_e_per_dn);
    camera.bias_dn = Some(canvas.bias_dn);
    camera.read_noise_e = Some(canvas.read_noise_e);
    camera.saturation_dn = Some(SATURATION_DN);
    let [width_px, height_px] = canvas.size_px;
    for FrameEntry { file, number, size, .. } in &mut recording.frames {
        *file = Some(PathBuf::from(format!("frames/{number:04}.fits")));
        *size = Some(FrameSize { width_px, height_px });
    }
    recording
}

/// Writes the recording: recording.toml and frames.
pub fn write_pixels(folder: &Path, lists: &Lists, canvas: &Canvas) -> Result<(), BlindError> {
    let recording = pixel_recording(lists, canvas);
    let [width_px, height_px] = canvas.size_px;
    for (entry, pixels_dn) in recording.frames.iter().zip(canvas.frames()) {
        let headers = FitsHeaders::new(&recording.camera, recording.site.as_ref(), entry);
        let file = entry.file.as_deref().unwrap_or(Path::new(""));
        write_fits_u16(&folder.join(file), width_px, height_px, &pixels_dn, &headers)?;
    }
    write_manifest(folder, &recording)?;
    Ok(())
}

/// The control points and options that a painted recording leads to, and what it took.
#[derive(Clone, Debug)]
pub struct Painted {
    /// What the diagnosis is asked.
    pub question: DiagnosisRequest,
    /// Frames identified.
    pub frames_identified: usize,
    /// Wall time of painting, measuring, identifying and of the baseline, s.
    pub seconds_by_step: [f64; 4],
}

/// Paints the frames and goes the way of `boresight diagnose --physics MODEL` with them, up to the question.
pub fn painted(lists: &Lists, canvas: &Canvas, catalog: &Catalog, options: &DiagnoseOptions) -> Result<Painted, PipelineError> {
    let start = Instant::now();
    let [width_px, height_px] = canvas.size_px;
    let frames = canvas.frames();
    let painted = start.elapsed().as_secs_f64();
    let frame = |_: &Recording, index: usize| {
        let pixels_dn = frames[index].iter().map(|count| f32::from(*count)).collect();
        Ok(Ok(Frame { width_px, height_px, pixels_dn, saturation_dn: SATURATION_DN as f32 }))
    };
    let mut measured = measure_frames(pixel_recording(lists, canvas), frame, &MeasureOptions::default(), || ())?;
    let found = start.elapsed().as_secs_f64();
    let physics = lists.model.iter().map(|id| (*id).to_owned()).collect();
    let choice = SkyChoice { physics: Physics::List(physics), assumes_time: true };
    let search =
        IdentifyOptions { nominal_focal_length_px: measured.recording.camera.nominal_focal_length_px(), ..IdentifyOptions::default() };
    let identified = identify_frames(&measured, catalog, &choice, &search, || ())?;
    let named = start.elapsed().as_secs_f64();
    let prepared = control_points(&measured, &identified, catalog, None, false)?;
    let asked = DiagnosisInput { catalog, choice: &choice, max_magnitude: None, trusted: false };
    let options = DiagnoseOptions { proper_motion_only: measured.times_are_known(), ..options.clone() };
    let question = diagnosis_request(&mut measured, &identified, &prepared, &asked, options)?;
    Ok(Painted {
        question,
        frames_identified: identified.iter().filter(|frame| frame.solution().is_some()).count(),
        seconds_by_step: [painted, found - painted, named - found, start.elapsed().as_secs_f64() - named],
    })
}

/// The answer for one painted recording, and for its star lists. Where the stars truly are is looked up when the answer is complete.
#[must_use]
pub fn pixel_answer(family: Family, index: u32, seed: u64, options: &DiagnoseOptions) -> Answer {
    let catalog = Catalog::embedded();
    let Concealed { lists, canvas, .. } = concealed(family, index, seed, catalog);
    let none = |reason: String| Answer::none(family, index, seed, reason);
    let Some(canvas) = canvas else { return none("star lists have no pixels".to_owned()) };
    let options = DiagnoseOptions { seed: u64::from(index), ..options.clone() };
    let start = Instant::now();
    let painted = match painted(&lists, &canvas, catalog, &options) {
        Ok(painted) => painted,
        Err(error) => return none(whole(&error)),
    };
    let Painted { question: DiagnosisRequest { points, left_out, telemetry, options: asked, .. }, frames_identified, mut seconds_by_step } =
        painted;
    let mut answer = match diagnose(&points, &telemetry, &asked) {
        Ok(diagnosis) => shortened(&diagnosis, family, index, seed),
        Err(error) => return none(error.to_string()),
    };
    answer.seconds = start.elapsed().as_secs_f64();
    seconds_by_step[3] = answer.seconds - seconds_by_step[..3].iter().sum::<f64>();
    let (stars_right, stars_wrong, centres) = compared(points.points.iter().chain(&left_out), &canvas.stars);
    answer.pixels = Some(Box::new(PixelAnswer {
        lists: answer_of_lists(&lists, family, index, seed, &options, false),
        frames_identified,
        frames: canvas.stars.len(),
        stars_painted: canvas.stars.iter().flatten().filter(|star| star.is_alone).count(),
        stars_right,
        stars_wrong,
        centres,
        seconds_by_step,
    }));
    answer
}

/// Names and centres of control points against the painted stars: right names, wrong names, errors of the centres.
fn compared<'a>(points: impl Iterator<Item = &'a ControlPoint>, stars: &[Vec<PaintedStar>]) -> (usize, usize, Centres) {
    let (mut right, mut wrong, mut centres) = (0, 0, Centres::default());
    for point in points {
        let star = stars.get(point.frame).and_then(|stars| stars.iter().find(|star| star.hip == point.hip));
        match star.map(|star| (star, [point.x_px - star.x_px, point.y_px - star.y_px])) {
            Some((star, [dx, dy])) if dx.hypot(dy) < SAME_STAR_PX => {
                // Of light that runs together there is no one right centre.
                if star.is_alone {
                    right += 1;
                    let [xx, _, yy] = point.covariance_px2;
                    centres.add(dx / xx.sqrt());
                    centres.add(dy / yy.sqrt());
                }
            }
            _ => wrong += 1,
        }
    }
    (right, wrong, centres)
}

/// An error with its causes.
pub(super) fn whole(error: &PipelineError) -> String {
    let causes = std::iter::successors(std::error::Error::source(error), |cause| cause.source());
    causes.fold(error.to_string(), |text, cause| format!("{text}: {cause}"))
}
