//! What is wrong with a system under test, in a sentence that names it: conventions, origin of pixels, aberration, mirrored images, focal length, names,
//! crashes. Each sentence rests on a test of its own against the truth of the frames; what answers cannot show is said too.

use super::answers::AnswerStatus;
use super::conventions::{Conventions, QuaternionOrder, RotationWay, SignedAxes, WrittenAttitude, agreements};
use super::samples::CaseScores;
use super::score::{SAME_STAR_PX, ScoredFrame};
use crate::camera::Camera;
use crate::coordinates::Attitude;
use crate::units::{ARCSEC_RAD, DEG_RAD};

/// A fault that the answers show.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize, schemars::JsonSchema)]
pub struct SystemFault {
    /// A short name that stays the same.
    pub name: &'static str,
    /// What is wrong, and how it shows.
    pub sentence: String,
}

fn fault(name: &'static str, sentence: String) -> SystemFault {
    SystemFault { name, sentence }
}

/// Speed of light.
const LIGHT_KM_S: f64 = 299_792.458;
/// Answers that agree with a convention lie within this of the truth.
const AGREES_RAD: f64 = 0.3 * DEG_RAD;

/// All faults of the answers of a case.
pub(super) fn faults(scores: &CaseScores, declared: &Conventions, camera: &Camera) -> Vec<SystemFault> {
    let mut all = ends(&scores.frames);
    let attitude = attitude_faults(&scores.frames, declared, camera);
    let places = place_faults(&scores.frames, camera);
    // Where centroids show what attitudes show too, the places say it more directly.
    let same = |own: &SystemFault| places.iter().any(|other| other.name == own.name);
    all.extend(attitude.into_iter().filter(|own| !same(own)));
    all.extend(places);
    all.extend(names(&scores.frames));
    all.extend(cameras(scores));
    all
}

/// What answers of this kind cannot show, where something is wrong and no fault was found.
pub(super) fn untold(scores: &CaseScores) -> Option<String> {
    let has_centroids = scores.frames.iter().any(|frame| frame.stars.is_some());
    let missing = match (has_centroids, !scores.cameras.is_empty()) {
        (true, true) => return None,
        (true, false) => "a wrong focal length (write camera.json beside the answer)",
        (false, true) => "wrong star identifications (write centroids.csv with ids beside the answer)",
        (false, false) => "a wrong focal length and wrong star identifications (write camera.json and centroids.csv beside the answer)",
    };
    Some(format!("from these answers one cannot tell {missing}"))
}

/// Crashes, time-outs, answers that are none.
fn ends(frames: &[ScoredFrame]) -> Vec<SystemFault> {
    let of = |status: AnswerStatus, name: &'static str, what: &str| {
        let own: Vec<&ScoredFrame> = frames.iter().filter(|frame| frame.status == status).collect();
        let first = own.first()?;
        let words = first.words.as_ref().map_or_else(String::new, |words| format!(": {words}"));
        Some(fault(name, format!("{what} at {} of {} frames; the first is frame {}{words}", own.len(), frames.len(), first.number)))
    };
    [
        of(AnswerStatus::Crashed, "crash", "the program ended by itself"),
        of(AnswerStatus::TimedOut, "hang", "the program did not answer in time"),
        of(AnswerStatus::Unreadable, "unreadable", "the answer cannot be read"),
    ]
    .into_iter()
    .flatten()
    .collect()
}

/// What the attitudes alone show; the first that explains them.
fn attitude_faults(frames: &[ScoredFrame], declared: &Conventions, camera: &Camera) -> Vec<SystemFault> {
    let pairs: Vec<(Attitude, WrittenAttitude)> = frames.iter().filter_map(|frame| Some((frame.truth, frame.written?))).collect();
    if pairs.len() < 3 {
        return Vec::new();
    }
    let read: Vec<(&ScoredFrame, Attitude)> = frames.iter().filter_map(|frame| Some((frame, declared.read(&frame.written?)?))).collect();
    let off = read.iter().filter(|(frame, read)| read.camera_from_icrs.angle_to(&frame.truth.camera_from_icrs) > AGREES_RAD).count();
    if off * 2 > pairs.len() || read.len() * 2 < pairs.len() {
        let found = convention(&pairs, declared).or_else(|| constant(&read, camera)).or_else(|| rolled(&read));
        if found.is_some() {
            return found.into_iter().collect();
        }
    }
    let mut found: Vec<SystemFault> = aberration(&read).into_iter().collect();
    if found.is_empty() {
        found.extend(constant(&read, camera));
    }
    found
}

/// Another convention than the declared one that nearly all answers agree with.
fn convention(pairs: &[(Attitude, WrittenAttitude)], declared: &Conventions) -> Option<SystemFault> {
    let all = agreements(pairs, AGREES_RAD);
    let best = all.first().filter(|best| best.agreeing * 10 >= pairs.len() * 8)?;
    // Of conventions that agree alike, that which differs least from what is declared is meant.
    let differs = |own: &Conventions| {
        u8::from(own.rotation != declared.rotation)
            + u8::from(own.quaternion != declared.quaternion)
            + 2 * u8::from(own.axes != declared.axes)
    };
    let alike = all.iter().filter(|own| own.agreeing == best.agreeing && own.median_rad < 2.0 * best.median_rad + 1e-9);
    let own = alike.min_by_key(|own| differs(&own.conventions)).unwrap_or(best);
    if differs(&own.conventions) == 0 {
        return None;
    }
    let (name, what) = convention_words(&own.conventions, declared);
    let agree = format!("{} of {} answers agree with {} and not with what is declared", own.agreeing, pairs.len(), own.conventions.words());
    Some(fault(name, format!("{what}: {agree}")))
}

fn convention_words(own: &Conventions, declared: &Conventions) -> (&'static str, String) {
    let mut words = Vec::new();
    let mut name = "axes";
    if own.rotation != declared.rotation {
        name = "conjugated";
        words.push(match own.rotation {
            RotationWay::IcrsFromCamera => "the quaternion is conjugated (it takes camera axes to ICRS axes)".to_owned(),
            RotationWay::CameraFromIcrs => "the quaternion is conjugated (it takes ICRS axes to camera axes)".to_owned(),
        });
    }
    if own.quaternion != declared.quaternion {
        name = "scalar-first";
        words.push(match own.quaternion {
            QuaternionOrder::Wxyz => "the quaternion has the scalar first".to_owned(),
            QuaternionOrder::Xyzw => "the quaternion has the scalar last".to_owned(),
        });
    }
    if own.axes != declared.axes {
        let (axes_name, what) = axes_words(&own.axes, &declared.axes);
        name = axes_name;
        words.push(what);
    }
    (name, words.join(", "))
}

/// What tells axes from the declared ones.
fn axes_words(own: &SignedAxes, declared: &SignedAxes) -> (&'static str, String) {
    let flipped: Vec<usize> =
        (0..3).filter(|axis| own.0[*axis].0 == declared.0[*axis].0 && own.0[*axis].1 != declared.0[*axis].1).collect();
    let same_order = (0..3).all(|axis| own.0[axis].0 == declared.0[axis].0);
    let letters = ["x", "y", "z"];
    match (same_order, flipped.as_slice()) {
        (true, [1]) => ("y-flipped", "the y axis is flipped: the image is mirrored top to bottom".to_owned()),
        (true, [0]) => ("mirrored", "the x axis is flipped: the image is mirrored left to right".to_owned()),
        (true, [1, 2]) => ("y-flipped", "the y axis is flipped (and z with it: y up, z toward the camera)".to_owned()),
        (true, [a, b]) => ("axes", format!("the axes {} and {} are reversed", letters[*a], letters[*b])),
        _ if own.is_mirrored() != declared.is_mirrored() => ("mirrored", format!("the axes are mirrored ({})", own.words())),
        _ => ("axes", format!("the camera axes are others ({})", own.words())),
    }
}

/// Boresights that are right, with rolls that are anything: stars of a mirrored image, matched and turned as well as a rotation can.
fn rolled(read: &[(&ScoredFrame, Attitude)]) -> Option<SystemFault> {
    let errors: Vec<_> = read.iter().map(|(frame, read)| super::score::AttitudeError::of(read, &frame.truth)).collect();
    let near = errors.iter().filter(|error| error.cross_rad < DEG_RAD).count();
    let rolled = errors.iter().filter(|error| error.cross_rad < DEG_RAD && error.about_rad.abs() > DEG_RAD).count();
    (near * 10 >= read.len() * 8 && rolled * 2 > near).then(|| {
        let sentence = format!(
            "the boresight is right and the roll is not in {rolled} of {} answers: the image is mirrored, or an axis of it is flipped",
            read.len()
        );
        fault("mirrored", sentence)
    })
}

/// The same turn in every frame: an origin of pixels that is off, or a boresight that lies elsewhere.
fn constant(read: &[(&ScoredFrame, Attitude)], camera: &Camera) -> Option<SystemFault> {
    if read.len() < 3 {
        return None;
    }
    let errors: Vec<_> = read.iter().map(|(frame, read)| super::score::AttitudeError::of(read, &frame.truth)).collect();
    let f = camera.focal_length_px;
    // Where the true boresight would be drawn if the answered one were the middle: a shift of all pixels.
    let shift = |error: &super::score::AttitudeError| {
        let scale = if error.cross_rad > 0.0 { error.cross_rad.tan() / error.cross_rad } else { 1.0 };
        error.boresight_rad.map(|own| f * scale * own)
    };
    let shifts: Vec<[f64; 2]> = errors.iter().filter(|error| error.cross_rad < 60.0 * DEG_RAD).map(shift).collect();
    if shifts.len() * 10 < errors.len() * 8 {
        return None;
    }
    let axis = |axis: usize| -> (f64, f64) {
        let mut own: Vec<f64> = shifts.iter().map(|shift| shift[axis]).collect();
        own.sort_by(f64::total_cmp);
        let middle = own[own.len() / 2];
        let kept: Vec<f64> = own.iter().copied().filter(|own| (own - middle).abs() < 3.0 + 0.02 * middle.abs()).collect();
        let mean = kept.iter().sum::<f64>() / kept.len() as f64;
        let square = kept.iter().map(|own| (own - mean).powi(2)).sum::<f64>() / (kept.len() as f64 - 1.0).max(1.0);
        (mean, (square / kept.len() as f64).sqrt())
    };
    let [(x, error_x), (y, error_y)] = [axis(0), axis(1)];
    shifted(
        [x, y],
        [error_x, error_y],
        [camera.width_px, camera.height_px],
        "the attitudes are those of pixels that are off by the same amount in every frame",
    )
}

/// Names a shift of all pixels, px, with its standard errors.
fn shifted([x, y]: [f64; 2], [error_x, error_y]: [f64; 2], [width, height]: [usize; 2], how: &str) -> Option<SystemFault> {
    let amount = format!("({x:+.2} ± {error_x:.2}, {y:+.2} ± {error_y:.2}) px");
    let middle = [(width as f64 - 1.0) / 2.0, (height as f64 - 1.0) / 2.0];
    let near_middle = |own: f64, middle: f64| (own.abs() - middle).abs() < 2.0 + 0.01 * middle;
    if near_middle(x, middle[0]) && near_middle(y, middle[1]) {
        return Some(fault(
            "origin-in-the-middle",
            format!("the origin of the pixels is in the middle of the frame and not at its first pixel: {how}, {amount}"),
        ));
    }
    let is_near = |own: f64, error: f64, size: f64| (own.abs() - size).abs() < (3.0 * error).clamp(0.08, 0.15) && error < 0.1;
    for (size, name, words) in [
        (0.5, "half-pixel-origin", "the origin of the pixels is half a pixel off (the corner of the first pixel, and not its centre)"),
        (1.0, "one-pixel-origin", "the origin of the pixels is one pixel off (pixels are counted from 1)"),
    ] {
        if is_near(x, error_x, size) && is_near(y, error_y, size) {
            return Some(fault(name, format!("{words}: {how}, {amount}")));
        }
    }
    let sure = |own: f64, error: f64| own.abs() > 6.0 * error.max(1e-6);
    (x.hypot(y) > 0.25 && (sure(x, error_x) || sure(y, error_y)))
        .then(|| fault("constant-offset", format!("{how}, {amount}: another boresight or principal point")))
}

/// Errors that follow the velocity of the camera: the regression of the boresight's error on that which stellar aberration makes has a slope of 1.
fn aberration(read: &[(&ScoredFrame, Attitude)]) -> Option<SystemFault> {
    let pair = |(frame, read): &(&ScoredFrame, Attitude)| {
        let velocity = frame.velocity_km_s?;
        let rows = frame.truth.rows();
        // The boresight of the catalogue's directions lies behind that of the light by the velocity across it.
        let across = |row: [f64; 3]| -row.iter().zip(&velocity).map(|(a, b)| a * b).sum::<f64>() / LIGHT_KM_S;
        let error = super::score::AttitudeError::of(read, &frame.truth);
        (error.cross_rad < 10.0 * 60.0 * ARCSEC_RAD)
            .then(|| [[across(rows[0]), error.boresight_rad[0]], [across(rows[1]), error.boresight_rad[1]]])
    };
    let pairs: Vec<[f64; 2]> = read.iter().filter_map(pair).flatten().collect();
    if pairs.len() < 10 {
        return None;
    }
    // Both axes may have an offset of their own; every second number is of one axis.
    let slope = |axis: usize| -> (f64, f64, f64) {
        let own: Vec<[f64; 2]> = pairs.iter().skip(axis).step_by(2).copied().collect();
        let mean = own.iter().fold([0.0; 2], |sum, pair| [sum[0] + pair[0], sum[1] + pair[1]]).map(|sum| sum / own.len() as f64);
        let sums = own.iter().fold([0.0; 3], |sums, pair| {
            let [p, e] = [pair[0] - mean[0], pair[1] - mean[1]];
            [sums[0] + p * p, sums[1] + p * e, sums[2] + e * e]
        });
        (sums[0], sums[1], sums[2])
    };
    let (a, b) = (slope(0), slope(1));
    let (pp, pe, ee) = (a.0 + b.0, a.1 + b.1, a.2 + b.2);
    if pp <= 0.0 {
        return None;
    }
    let k = pe / pp;
    let freedom = (pairs.len() - 3) as f64;
    let error = ((ee - k * pe).max(0.0) / freedom / pp).sqrt();
    (k > 5.0 * error && (k - 1.0).abs() < (3.0 * error).clamp(0.1, 0.4)).then(|| {
        let arcsec = (pp / pairs.len() as f64 * 2.0).sqrt() / ARCSEC_RAD;
        fault("aberration", format!("stellar aberration is left out: the boresight follows the velocity of the camera with {k:.2} ± {error:.2} of its size ({arcsec:.1}\" rms)"))
    })
}

/// A place of the frame turned or moved.
type Turn = Box<dyn Fn([f64; 2]) -> [f64; 2]>;

/// What centroids show: flips and shifts of the frame.
fn place_faults(frames: &[ScoredFrame], camera: &Camera) -> Vec<SystemFault> {
    let (width, height) = (camera.width_px as f64, camera.height_px as f64);
    let told: Vec<&ScoredFrame> = frames.iter().filter(|frame| frame.places_px.len() >= 3 && frame.bright_px.len() >= 3).collect();
    if told.is_empty() {
        return Vec::new();
    }
    let middle = [(width - 1.0) / 2.0, (height - 1.0) / 2.0];
    let turns: [(&'static str, &'static str, Turn); 6] = [
        ("", "", Box::new(|place| place)),
        (
            "y-flipped",
            "the y axis of the pixels is flipped: rows are counted from the bottom",
            Box::new(move |[x, y]| [x, height - 1.0 - y]),
        ),
        (
            "mirrored",
            "the x axis of the pixels is flipped: the image is mirrored left to right",
            Box::new(move |[x, y]| [width - 1.0 - x, y]),
        ),
        ("turned", "the frame is turned by half a turn", Box::new(move |[x, y]| [width - 1.0 - x, height - 1.0 - y])),
        ("transposed", "rows and columns are exchanged", Box::new(|[x, y]| [y, x])),
        (
            "origin-in-the-middle",
            "the origin of the pixels is in the middle of the frame and not at its first pixel",
            Box::new(move |[x, y]| [x + middle[0], y + middle[1]]),
        ),
    ];
    let hits = |turn: &Turn| {
        let near = |frame: &ScoredFrame, place: [f64; 2]| {
            let [x, y] = turn(place);
            frame.bright_px.iter().any(|[u, v]| (u - x).hypot(v - y) <= SAME_STAR_PX)
        };
        told.iter().map(|frame| frame.places_px.iter().take(60).filter(|place| near(frame, **place)).count()).sum::<usize>()
    };
    let all: usize = told.iter().map(|frame| frame.places_px.len().min(60)).sum();
    let counts: Vec<usize> = turns.iter().map(|(_, _, turn)| hits(turn)).collect();
    let best = (0..turns.len()).max_by_key(|index| (counts[*index], usize::MAX - index)).unwrap_or(0);
    if best > 0 && counts[best] * 2 > all && counts[best] > 2 * counts[0] {
        let (name, words, _) = &turns[best];
        return vec![fault(name, format!("{words}: then {} of {all} centroids lie on stars, as they are {}", counts[best], counts[0]))];
    }
    place_shift(&told, [camera.width_px, camera.height_px]).into_iter().collect()
}

/// The mean shift of centroids from their stars.
fn place_shift(told: &[&ScoredFrame], size_px: [usize; 2]) -> Option<SystemFault> {
    let errors: Vec<[f64; 2]> =
        told.iter().flat_map(|frame| frame.stars.iter().flatten()).filter(|star| star.is_clean).filter_map(|star| star.error_px).collect();
    if errors.len() < 20 {
        return None;
    }
    let axis = |axis: usize| {
        let mut own: Vec<f64> = errors.iter().map(|error| error[axis]).collect();
        own.sort_by(f64::total_cmp);
        let middle = own[own.len() / 2];
        let spread = own.iter().map(|own| (own - middle).abs()).sum::<f64>() / own.len() as f64;
        (middle, 1.6 * spread / (own.len() as f64).sqrt())
    };
    let [(x, error_x), (y, error_y)] = [axis(0), axis(1)];
    shifted([x, y], [error_x, error_y], size_px, "centroids are off by the same amount everywhere")
        .filter(|fault| fault.name != "constant-offset" || x.hypot(y) > 0.25)
}

/// Names of stars that are others.
fn names(frames: &[ScoredFrame]) -> Vec<SystemFault> {
    let named: usize = frames.iter().filter(|frame| frame.is_right).map(|frame| frame.named).sum();
    let misnamed: usize = frames.iter().filter(|frame| frame.is_right).map(|frame| frame.misnamed).sum();
    // A few are what neighbours make.
    if named < 20 || misnamed * 200 < named {
        return Vec::new();
    }
    let share = 100.0 * misnamed as f64 / named as f64;
    let sentence = format!(
        "{share:.1} % of the star identifications are wrong: {misnamed} of {named} stars bear the name of another, in frames whose attitude is right"
    );
    vec![fault("wrong-ids", sentence)]
}

/// What `camera.json` shows.
fn cameras(scores: &CaseScores) -> Vec<SystemFault> {
    let mut all = Vec::new();
    let values: Vec<f64> = scores.cameras.iter().filter_map(|camera| camera.focal_length_relative).collect();
    if let Some((middle, spread)) = middle_of(&values)
        && middle.abs() > 2e-4
        && middle.abs() > 3.0 * spread / (values.len() as f64).sqrt()
    {
        let word = if middle > 0.0 { "long" } else { "short" };
        all.push(fault(
            "focal-length",
            format!("the focal length is {:.3} % too {word} (camera.json, {} cameras)", 100.0 * middle.abs(), values.len()),
        ));
    }
    let points: Vec<[f64; 2]> = scores.cameras.iter().filter_map(|camera| camera.principal_point_px).collect();
    let axis = |axis: usize| middle_of(&points.iter().map(|point| point[axis]).collect::<Vec<_>>());
    if let (Some((x, spread_x)), Some((y, spread_y))) = (axis(0), axis(1))
        && ((x.abs() - 0.5).abs() < 0.02 && (y.abs() - 0.5).abs() < 0.02 && spread_x < 0.05 && spread_y < 0.05)
    {
        all.push(fault(
            "half-pixel-origin",
            format!("the principal point is half a pixel off, ({x:+.2}, {y:+.2}) px: the origin of its pixels is a corner"),
        ));
    }
    all
}

fn middle_of(values: &[f64]) -> Option<(f64, f64)> {
    let mut own = values.to_vec();
    own.sort_by(f64::total_cmp);
    let middle = *own.get(own.len() / 2)?;
    let spread = own.iter().map(|own| (own - middle).abs()).sum::<f64>() / own.len() as f64;
    Some((middle, 1.3 * spread))
}
