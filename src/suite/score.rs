//! An answer held against the truth.

use nalgebra::Vector3;

use super::answers::{AnswerStatus, AnsweredCamera, TrackerAnswer};
use super::attitudes::DesignPlace;
use super::conventions::{Conventions, WrittenAttitude};
use super::frames::HandedFrame;
use super::system::ObservedAnswer;
use crate::calibrate::mapping_error_px;
use crate::camera::Camera;
use crate::coordinates::Attitude;
use crate::render::TrueStar;
use crate::statistics::order::sort_by;

/// A centroid nearer than this to a star is that star's.
pub(super) const SAME_STAR_PX: f64 = 3.0;

/// The error of an attitude, in the camera's own axes.
#[derive(Clone, Copy, Debug, PartialEq)]
#[allow(clippy::struct_field_names, reason = "units stand in names")]
pub(super) struct AttitudeError {
    /// Where the answered boresight lies beside the true one, along x and y, rad.
    pub boresight_rad: [f64; 2],
    /// The angle between them.
    pub cross_rad: f64,
    /// The turn about the boresight, rad.
    pub about_rad: f64,
}

impl AttitudeError {
    /// Of an answer against the truth.
    #[must_use]
    pub(super) fn of(answer: &Attitude, truth: &Attitude) -> Self {
        let seen = truth.camera_from_icrs * Vector3::from(answer.rows()[2]);
        let turn = (answer.camera_from_icrs * truth.camera_from_icrs.inverse()).scaled_axis();
        let across = seen.x.hypot(seen.y);
        let cross_rad = across.atan2(seen.z);
        let scale = if across > 0.0 { cross_rad / across } else { 1.0 };
        Self { boresight_rad: [scale * seen.x, scale * seen.y], cross_rad, about_rad: turn.z }
    }
}

/// A true star of a frame, and what became of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct SeenStar {
    pub(super) snr: f64,
    /// Whether it stands alone, wholly on the frame and below saturation.
    pub(super) is_clean: bool,
    /// Measured minus true place.
    pub(super) error_px: Option<[f64; 2]>,
    /// Its true place.
    pub(super) place_px: [f64; 2],
    pub(super) is_named: bool,
}

/// A frame with its answer, scored.
#[derive(Clone, Debug)]
pub(super) struct ScoredFrame {
    pub(super) number: usize,
    pub(super) place: DesignPlace,
    pub(super) status: AnswerStatus,
    pub(super) words: Option<String>,
    pub(super) truth: Attitude,
    pub(super) velocity_km_s: Option<[f64; 3]>,
    pub(super) written: Option<WrittenAttitude>,
    pub(super) error: Option<AttitudeError>,
    pub(super) is_right: bool,
    /// Stars of the truth; `None`: the answer has no centroids.
    pub(super) stars: Option<Vec<SeenStar>>,
    pub(super) false_stars: usize,
    pub(super) named: usize,
    pub(super) misnamed: usize,
    /// Centroids as they came, in our pixels if the declared origin holds, with their number of named ones.
    pub(super) places_px: Vec<[f64; 2]>,
    pub(super) latency_s: Option<f64>,
    pub(super) peak_mib: Option<f64>,
    /// The brightest true places, for questions about conventions.
    pub(super) bright_px: Vec<[f64; 2]>,
}

/// How an answer is judged.
#[derive(Clone, Copy, Debug)]
pub(super) struct Judging<'a> {
    pub(super) conventions: &'a Conventions,
    pub(super) within_rad: f64,
    pub(super) about_within_rad: f64,
    pub(super) size_px: [usize; 2],
}

/// Scores the answer to a frame.
pub(super) fn scored(frame: &HandedFrame, observed: ObservedAnswer, judging: &Judging<'_>) -> ScoredFrame {
    let ObservedAnswer { answer, latency_s, peak_mib } = observed;
    let truth = frame.truth.attitude;
    let read = answer.attitude.as_ref().and_then(|written| judging.conventions.read(written));
    let error = read.map(|read| AttitudeError::of(&read, &truth));
    let is_right = error.is_some_and(|error| error.cross_rad <= judging.within_rad && error.about_rad.abs() <= judging.about_within_rad);
    let mut own = ScoredFrame {
        number: frame.number,
        place: frame.place,
        status: answer.status,
        words: answer.error.clone(),
        truth,
        velocity_km_s: frame.truth.velocity_km_s,
        written: answer.attitude,
        error,
        is_right,
        stars: None,
        false_stars: 0,
        named: 0,
        misnamed: 0,
        places_px: Vec::new(),
        latency_s,
        peak_mib,
        bright_px: Vec::new(),
    };
    star_scores(&mut own, &frame.truth.stars, &answer, judging);
    own
}

/// Holds centroids against the stars: each star has the nearest centroid, and each centroid one star.
fn star_scores(own: &mut ScoredFrame, truth: &[TrueStar], answer: &TrackerAnswer, judging: &Judging<'_>) {
    const BRIGHT: usize = 60;
    own.bright_px = truth.iter().filter(|star| star.snr >= 5.0).take(BRIGHT).map(|star| [star.x_mean_px, star.y_mean_px]).collect();
    let Some(centroids) = &answer.centroids else { return };
    own.places_px = centroids.iter().map(|star| judging.conventions.pixel([star.x, star.y], judging.size_px)).collect();
    let mut pairs: Vec<(f64, usize, usize)> = Vec::new();
    for (star_index, star) in truth.iter().enumerate() {
        for (index, [x, y]) in own.places_px.iter().enumerate() {
            let apart = (x - star.x_mean_px).hypot(y - star.y_mean_px);
            if apart <= SAME_STAR_PX {
                pairs.push((apart, star_index, index));
            }
        }
    }
    // Brighter stars first among those at a place: a faint one beside them is not what was found.
    sort_by(&mut pairs, |a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let (mut star_of, mut centroid_of) = (vec![None; centroids.len()], vec![None; truth.len()]);
    for (_, star, centroid) in pairs {
        if star_of[centroid].is_none() && centroid_of[star].is_none() && truth[star].snr >= 1.0 {
            star_of[centroid] = Some(star);
            centroid_of[star] = Some(centroid);
        }
    }
    own.false_stars = star_of.iter().filter(|star| star.is_none()).count();
    let near = |hip: u32, [x, y]: [f64; 2]| {
        truth.iter().any(|star| star.hip == hip && (star.x_mean_px - x).hypot(star.y_mean_px - y) <= SAME_STAR_PX)
    };
    let names = centroids.iter().zip(&own.places_px).filter_map(|(star, place)| Some((star.hip?, *place)));
    let is_good: Vec<bool> = names.map(|(hip, place)| near(hip, place)).collect();
    (own.named, own.misnamed) = (is_good.len(), is_good.iter().filter(|good| !**good).count());
    let seen = |(index, star): (usize, &TrueStar)| {
        let place_px = [star.x_mean_px, star.y_mean_px];
        let own_centroid = centroid_of[index];
        let error_px = own_centroid.map(|at| [0, 1].map(|axis| own.places_px[at][axis] - place_px[axis]));
        let is_named = centroids
            .iter()
            .zip(&own.places_px)
            .any(|(given, [x, y])| given.hip == Some(star.hip) && (x - place_px[0]).hypot(y - place_px[1]) <= SAME_STAR_PX);
        SeenStar { snr: star.snr, is_clean: !star.saturated && !star.blended && !star.edge, error_px, place_px, is_named }
    };
    own.stars = Some(truth.iter().enumerate().filter(|(_, star)| star.snr >= 2.0).map(seen).collect());
}

/// A camera held against the true one.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct CameraScore {
    pub(super) focal_length_relative: Option<f64>,
    pub(super) principal_point_px: Option<[f64; 2]>,
    /// Errors over their standard errors.
    pub(super) pulls: Vec<f64>,
    /// Rms over the frame after the best rotation.
    pub(super) map_px: Option<f64>,
}

impl CameraScore {
    /// Of an answered camera. What it does not tell is that of the truth.
    pub(super) fn of(answer: &AnsweredCamera, truth: &Camera) -> Self {
        let mut camera = *truth;
        camera.focal_length_px = answer.focal_length_px.unwrap_or(truth.focal_length_px);
        camera.principal_point_px = answer.principal_point_px.unwrap_or(truth.principal_point_px);
        camera.k1 = answer.k1.unwrap_or(truth.k1);
        let pull = |own: Option<f64>, truth: f64, sigma: Option<f64>| Some((own? - truth) / sigma.filter(|sigma| *sigma > 0.0)?);
        let axis = |place: usize| {
            pull(
                answer.principal_point_px.map(|point| point[place]),
                truth.principal_point_px[place],
                answer.principal_point_sigma_px.map(|sigma| sigma[place]),
            )
        };
        let pulls = [
            pull(answer.focal_length_px, truth.focal_length_px, answer.focal_length_sigma_px),
            axis(0),
            axis(1),
            pull(answer.k1, truth.k1, answer.k1_sigma),
        ];
        Self {
            focal_length_relative: answer.focal_length_px.map(|f| f / truth.focal_length_px - 1.0),
            principal_point_px: answer.principal_point_px.map(|point| [0, 1].map(|axis| point[axis] - truth.principal_point_px[axis])),
            pulls: pulls.into_iter().flatten().collect(),
            map_px: mapping_error_px(truth, &camera).map(|error| error.rms_px),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_are_told_in_the_axes_of_the_camera() {
        let truth = Attitude::from_pointing(1.0, 0.3, 2.0);
        let error = AttitudeError::of(&truth.turned([0.0, 1e-4, 0.0]), &truth);
        assert!((error.cross_rad - 1e-4).abs() < 1e-9 && error.about_rad.abs() < 1e-12);
        assert!((error.boresight_rad[0] - 1e-4).abs() < 1e-9 && error.boresight_rad[1].abs() < 1e-9, "{error:?}");
        let rolled = AttitudeError::of(&truth.turned([0.0, 0.0, 2e-3]), &truth);
        assert!(rolled.cross_rad < 1e-12 && (rolled.about_rad.abs() - 2e-3).abs() < 1e-9);
        assert!((AttitudeError::of(&truth.turned([2.0, 0.0, 0.0]), &truth).cross_rad - 2.0).abs() < 1e-9);
    }
}
