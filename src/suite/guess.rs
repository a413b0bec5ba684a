//! `--guess-conventions`: clean frames are handed over, and every convention is held against the answers: 2 ways of the rotation × 2 orders of the
//! quaternion × 48 axes (24 of them mirrored) × 3 origins of the pixels. A system that answers nothing gets the frames mirrored too.

use super::answers::AnswerStatus;
use super::conventions::{Conventions, PixelOrigin, WrittenAttitude, agreements};
use super::error::SuiteError;
use super::frames::{FrameBatch, HandedFrame};
use super::plan::SuitePlan;
use super::score::SAME_STAR_PX;
use super::system::{ForeignSystem, ObservedAnswer};
use crate::catalog::Catalog;
use crate::coordinates::Attitude;
use crate::render::PsfTables;
use crate::units::DEG_RAD;

/// Frames that are handed over.
pub const GUESS_FRAMES: usize = 20;
/// Answers agree within this: clean frames, and no system is so far off.
const AGREES_RAD: f64 = 0.3 * DEG_RAD;

/// What a guess found.
#[derive(Clone, Debug)]
pub struct Guess {
    /// Frames with an attitude.
    pub answered: usize,
    /// Those of them that agree with what the suite declares.
    pub agree_as_declared: usize,
    /// The conventions that agree with the most answers, each in words, with that number.
    pub agreeing: Vec<(String, usize)>,
    /// The origin of pixels that centroids agree with, where there are any: in words, with the rms distance to the stars.
    pub origin: Option<(String, f64)>,
    /// Frames with an attitude when the images were mirrored, where that was tried.
    pub answered_mirrored: Option<usize>,
    /// The answer, in sentences.
    pub sentences: Vec<String>,
}

/// Hands clean frames over and holds all conventions against the answers.
pub fn guess_conventions(plan: &SuitePlan, catalog: &Catalog) -> Result<Guess, SuiteError> {
    let none = |message: &str| SuiteError::Parse { path: plan.path.clone(), message: message.to_owned() };
    let system = plan.file.system.as_ref().ok_or_else(|| none("there is no [system] whose conventions could be guessed"))?;
    let case = plan.cases.first().ok_or_else(|| none("there is no case"))?;
    let mut foreign = ForeignSystem::new(system);
    let mut seen: Vec<(HandedFrame, ObservedAnswer)> = Vec::new();
    let mut mirrored = None;
    let mut size_px = [0; 2];
    for batch in case.batches(0, 0..GUESS_FRAMES)? {
        size_px = [batch.scene.camera.width_px, batch.scene.camera.height_px];
        let frames = batch.render(&case.name, catalog, &PsfTables::default())?;
        let answers = foreign.answers(&batch, &frames)?;
        let solved = |answers: &[ObservedAnswer]| answers.iter().filter(|own| own.answer.status == AnswerStatus::Solved).count();
        if solved(&answers) * 4 < frames.len() {
            let turned = mirrored_frames(&batch, &frames);
            mirrored = Some(mirrored.unwrap_or(0) + solved(&foreign.answers(&batch, &turned)?));
        }
        seen.extend(frames.into_iter().zip(answers));
    }
    Ok(guessed(plan, (&seen, size_px), mirrored))
}

/// The frames with their columns in the opposite order.
fn mirrored_frames(batch: &FrameBatch, frames: &[HandedFrame]) -> Vec<HandedFrame> {
    let width = batch.scene.camera.width_px;
    let turned = |frame: &HandedFrame| {
        let mut frame = frame.clone();
        frame.pixels_dn.chunks_mut(width).for_each(<[u16]>::reverse);
        frame
    };
    frames.iter().map(turned).collect()
}

fn guessed(plan: &SuitePlan, (seen, size_px): (&[(HandedFrame, ObservedAnswer)], [usize; 2]), answered_mirrored: Option<usize>) -> Guess {
    let pairs: Vec<(Attitude, WrittenAttitude)> =
        seen.iter().filter_map(|(frame, own)| Some((frame.truth.attitude, own.answer.attitude?))).collect();
    let read = |(truth, written): &&(Attitude, WrittenAttitude)| {
        plan.conventions.read(written).is_some_and(|read| read.camera_from_icrs.angle_to(&truth.camera_from_icrs) < AGREES_RAD)
    };
    let agree_as_declared = pairs.iter().filter(read).count();
    let all = agreements(&pairs, AGREES_RAD);
    let most = all.first().map_or(0, |best| best.agreeing);
    let agreeing: Vec<(String, usize)> = all
        .iter()
        .filter(|own| own.agreeing == most && most * 5 >= pairs.len() * 4)
        .map(|own| (own.conventions.words(), own.agreeing))
        .collect();
    let origin = origin(seen, size_px);
    let mut sentences = Vec::new();
    let frames = seen.len();
    if pairs.is_empty() {
        sentences.push(format!("none of {frames} clean frames was answered with an attitude"));
        sentences.push(match answered_mirrored {
            Some(count) if count * 4 >= frames => format!(
                "{count} of {frames} were when the images were mirrored left to right: it takes the sky mirrored, as with rows from the bottom or x to the left"
            ),
            _ => "nor when the images were mirrored left to right: image form, focal length or brightness are not what it needs".to_owned(),
        });
    } else if agree_as_declared * 5 >= pairs.len() * 4 {
        sentences.push(format!("{agree_as_declared} of {} answers agree with what is declared: {}", pairs.len(), plan.conventions.words()));
    } else if let Some((words, count)) = agreeing.first() {
        sentences.push(format!("{count} of {} answers agree with {words}; {agree_as_declared} with what is declared", pairs.len()));
        if agreeing.len() > 1 {
            sentences.push(format!(
                "{} other conventions agree as well, so more frames or other attitudes are needed to tell them apart",
                agreeing.len() - 1
            ));
        }
    } else {
        sentences.push(format!(
            "none of the 2 × 2 × 48 conventions agrees with more than {most} of {} answers: they are wrong, or of another sky",
            pairs.len()
        ));
    }
    match &origin {
        Some((words, rms)) => sentences.push(format!("centroids agree best with pixel_origin = {words} ({rms:.3} px rms from the stars)")),
        None => sentences.push("the origin of pixels cannot be told: the answers hold no centroids".to_owned()),
    }
    Guess { answered: pairs.len(), agree_as_declared, agreeing, origin, answered_mirrored, sentences }
}

/// The origin of pixels under which centroids lie nearest to stars.
fn origin(seen: &[(HandedFrame, ObservedAnswer)], size_px: [usize; 2]) -> Option<(String, f64)> {
    let origins =
        [("0.0", PixelOrigin::At(0.0)), ("0.5", PixelOrigin::At(0.5)), ("1.0", PixelOrigin::At(1.0)), ("\"middle\"", PixelOrigin::Middle)];
    let of = |origin: PixelOrigin| -> Option<(usize, f64)> {
        let conventions = Conventions { pixel_origin: origin, ..Conventions::default() };
        let mut squares = Vec::new();
        for (frame, own) in seen {
            let Some(centroids) = &own.answer.centroids else { continue };
            for star in centroids {
                let [x, y] = conventions.pixel([star.x, star.y], size_px);
                let nearest =
                    frame.truth.stars.iter().filter(|star| star.snr > 5.0).map(|star| (star.x_mean_px - x).hypot(star.y_mean_px - y));
                let nearest = nearest.fold(f64::INFINITY, f64::min);
                if nearest < SAME_STAR_PX {
                    squares.push(nearest * nearest);
                }
            }
        }
        squares.sort_by(f64::total_cmp);
        let kept = &squares[..squares.len() * 9 / 10];
        (!kept.is_empty()).then(|| (kept.len(), (kept.iter().sum::<f64>() / kept.len() as f64).sqrt()))
    };
    let all: Vec<(&str, usize, f64)> =
        origins.iter().filter_map(|(words, origin)| of(*origin).map(|(count, rms)| (*words, count, rms))).collect();
    let most = all.iter().map(|(_, count, _)| *count).max()?;
    let best = all.into_iter().filter(|(_, count, _)| *count * 2 > most).min_by(|a, b| a.2.total_cmp(&b.2))?;
    Some((best.0.to_owned(), best.2))
}
