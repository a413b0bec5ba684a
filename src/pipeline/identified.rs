//! Identification of a recording's frames.

use std::time::{Duration, Instant};

use rayon::prelude::*;

use super::{Measured, MeasuredFrame, PipelineError, SkyChoice};
use crate::camera::SkyChain;
use crate::catalog::Catalog;
use crate::coordinates::{Apparent, Attitude, Direction};
use crate::effects::Observation;
use crate::identify::{
    ASSUMED_EPOCH_YR, AttitudePrior, Identification, IdentifyOptions, Index, Projection, Refusal, Solution, common_projection, identify,
};
use crate::parallel;
use crate::recording::Recording;
use crate::statistics::median;
use crate::units::DEG_RAD;

/// How far a camera may have turned from the nearest frame that is identified, where its attitude is taken for a hint.
const TURNED_RAD: f64 = 10.0 * DEG_RAD;
/// By so much the focal length of another frame of the same camera may differ: of any, and of one as wide as this (half a side over f).
const SAME: f64 = 0.01;
const SAME_OF_WIDE: f64 = 0.12;
const WIDE: f64 = 0.36;

/// A frame whose identification was tried.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct IdentifiedFrame {
    /// The answer.
    pub identification: Identification,
    /// The physics in force.
    pub sky: SkyChain,
    /// How long it took, measuring included, wall time, s.
    pub seconds: f64,
}

impl IdentifiedFrame {
    /// The direction from which a catalogue star's light arrived. It is not kept: those of all stars in all frames would fill the memory.
    #[must_use]
    pub fn direction(&self, catalog: &Catalog, star: usize) -> Direction<Apparent> {
        self.sky.apparent(&catalog.stars[star], catalog.epoch_yr)
    }

    /// The solution, if there is one.
    #[must_use]
    pub fn solution(&self) -> Option<&Solution> {
        match &self.identification {
            Identification::Identified(solution) => Some(solution),
            Identification::NotIdentified { .. } => None,
        }
    }
}

/// What the recording knows of the circumstances of its frames.
pub fn circumstances(recording: &Recording) -> Result<Vec<Observation>, PipelineError> {
    recording.observations().map_err(|(frame, source)| PipelineError::Observer { frame: recording.frame_name(frame), source })
}

/// Identifies every frame; `done` is called after each. Frames that resist alone are tried once more with the focal length that the others
/// agree on.
pub fn identify_frames(
    measured: &Measured,
    catalog: &Catalog,
    physics: &SkyChoice,
    options: &IdentifyOptions,
    done: impl Fn() + Sync,
) -> Result<Vec<IdentifiedFrame>, PipelineError> {
    let index = Index::new(catalog);
    if options.time_limit.is_some() {
        index.build(); // on nobody's time
    }
    let known = circumstances(&measured.recording)?;
    let (mut frames, searched): (Vec<IdentifiedFrame>, Vec<Duration>) =
        parallel::map(&measured.frames, |frame| -> Result<(IdentifiedFrame, Duration), PipelineError> {
            let start = Instant::now();
            let sky = sky_chain(&known, frame, physics)?;
            let directions = sky.apparent_all(catalog);
            let search = Instant::now();
            let measuring = Duration::try_from_secs_f64(frame.seconds).unwrap_or_default();
            let options = IdentifyOptions { time_spent: measuring, ..options.clone() };
            let identification = identify(&frame.detections, catalog, &index, &directions, &options);
            let searched = measuring + search.elapsed();
            done();
            Ok((IdentifiedFrame { identification, sky, seconds: frame.seconds + start.elapsed().as_secs_f64() }, searched))
        })
        .into_iter()
        .collect::<Result<Vec<_>, _>>()?
        .into_iter()
        .unzip();
    if measured.recording.common_size().is_ok() {
        retry(measured, catalog, &index, options, &mut frames, &searched);
    }
    Ok(frames)
}

/// The frames of a star list whose own identifications are taken: nothing is searched for.
pub fn take_identifications(measured: &Measured, physics: &SkyChoice) -> Result<Vec<IdentifiedFrame>, PipelineError> {
    let known = circumstances(&measured.recording)?;
    measured
        .frames
        .iter()
        .map(|frame| {
            let sky = sky_chain(&known, frame, physics)?;
            let identification = Identification::NotIdentified { reason: Refusal::Preidentified, hypotheses: 0 };
            Ok(IdentifiedFrame { identification, sky, seconds: frame.seconds })
        })
        .collect()
}

/// The physics in force during a frame.
fn sky_chain(known: &[Observation], frame: &MeasuredFrame, choice: &SkyChoice) -> Result<SkyChain, PipelineError> {
    let mut observation = known[frame.index];
    if observation.epoch_yr.is_none() && choice.assumes_time {
        observation.epoch_yr = Some(ASSUMED_EPOCH_YR);
    }
    SkyChain::new(&choice.physics, observation).map_err(|source| PipelineError::Physics { frame: frame.name.clone(), source })
}

/// The effects in force in all frames, and a sentence if some act in a part of them only.
#[must_use]
pub fn physics_in_force(frames: &[IdentifiedFrame]) -> (Vec<&'static str>, Option<String>) {
    // In the order in which they are met, each with the frames that have it.
    let mut counts: Vec<(&'static str, usize)> = Vec::new();
    for id in frames.iter().flat_map(|frame| frame.sky.ids()) {
        match counts.iter_mut().find(|(known, _)| *known == id) {
            Some((_, count)) => *count += 1,
            None => counts.push((id, 1)),
        }
    }
    let (all, some): (Vec<_>, Vec<_>) = counts.into_iter().partition(|(_, count)| *count == frames.len());
    let [all, some] = [all, some].map(|list| list.into_iter().map(|(id, _)| id).collect::<Vec<_>>());
    let warning = (!some.is_empty()).then(|| {
        format!("{} could be computed for some of the frames only and is applied there alone: give all frames a time", some.join(", "))
    });
    (all, warning)
}

/// Tries the frames that were not identified with the median focal length of those that were: everywhere, then around the attitude of the
/// nearest of them, where fewer hypotheses are to be refuted. Each frame in the time that its first search has left of its limit.
fn retry(
    measured: &Measured,
    catalog: &Catalog,
    index: &Index,
    options: &IdentifyOptions,
    frames: &mut [IdentifiedFrame],
    searched: &[Duration],
) {
    let solved: Vec<(usize, Attitude)> =
        (0..).zip(&*frames).filter_map(|(number, frame)| frame.solution().map(|solution| (number, solution.attitude))).collect();
    if solved.len() == frames.len() {
        return;
    }
    let solutions = || frames.iter().filter_map(IdentifiedFrame::solution);
    let projection = common_projection(solutions().map(|solution| solution.projection));
    let of_most = solutions().filter(|solution| solution.projection == projection);
    let focal_lengths_px: Vec<f64> = of_most.map(|solution| solution.camera.focal_length_px).collect();
    let Some(focal_length_px) = median(&focal_lengths_px) else { return };
    let options = |tolerance: f64| IdentifyOptions {
        projection: Some(projection),
        nominal_focal_length_px: Some(focal_length_px),
        focal_length_tolerance: tolerance,
        search_beyond_tolerance: false,
        ..options.clone()
    };
    // Of a wide field focal length and distortion stand in for each other: another frame of the same camera has another of both.
    let half_px =
        measured.frames.iter().map(|frame| frame.detections.width_px.max(frame.detections.height_px)).max().unwrap_or(0) as f64 / 2.0;
    let is_wide = projection == Projection::Pinhole && half_px > WIDE * focal_length_px;
    let tolerances: &[f64] = if is_wide { &[SAME, SAME_OF_WIDE] } else { &[SAME] };
    let all = frames.par_iter_mut().enumerate().zip(&measured.frames).zip(searched);
    all.filter(|(((_, frame), _), _)| frame.solution().is_none()).for_each(|(((number, frame), measured), searched)| {
        let begin = Instant::now();
        let nearest = solved.iter().min_by_key(|(other, _)| other.abs_diff(number));
        let around = nearest.map(|(_, attitude)| AttitudePrior::attitude(attitude, TURNED_RAD));
        let hypotheses = |identification: &Identification| match identification {
            Identification::Identified(_) => 0,
            Identification::NotIdentified { hypotheses, .. } => *hypotheses,
        };
        let mut hypotheses_before = hypotheses(&frame.identification);
        let directions = frame.sky.apparent_all(catalog);
        // Who says where the camera points is not asked to believe another frame.
        let asked = options(SAME);
        let places = || [asked.near].into_iter().chain(around.filter(|_| asked.near.is_none()).map(Some));
        for (tolerance, near) in tolerances.iter().flat_map(|tolerance| places().map(move |near| (*tolerance, near))) {
            let time_spent = *searched + begin.elapsed();
            if left_of(asked.time_limit, time_spent).is_some_and(|left| left.is_zero()) {
                break;
            }
            let options = IdentifyOptions { hypotheses_before, near, time_spent, ..options(tolerance) };
            let again = identify(&measured.detections, catalog, index, &directions, &options);
            if matches!(again, Identification::Identified(_)) {
                frame.identification = again;
                break;
            }
            hypotheses_before += hypotheses(&again);
        }
        frame.seconds += begin.elapsed().as_secs_f64();
    });
}

/// What is left of a limit, where there is one.
fn left_of(limit: Option<Duration>, spent: Duration) -> Option<Duration> {
    limit.map(|limit| limit.saturating_sub(spent))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_second_search_has_what_the_first_left() {
        let ms = Duration::from_millis;
        assert_eq!(left_of(None, ms(900)), None);
        assert_eq!(left_of(Some(ms(100)), ms(30)), Some(ms(70)));
        assert_eq!(left_of(Some(ms(100)), ms(100)), Some(ms(0)));
        assert_eq!(left_of(Some(ms(100)), ms(130)), Some(ms(0)));
    }
}
