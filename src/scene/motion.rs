//! Camera motion during an exposure.
//!
//! The attitude is a function of the time from the middle of the exposure: at rest, at an even rate, along a curve through given attitudes,
//! or fast to the turning Earth; on it stands jitter. Jitter is a sum of sinusoids with phases of the frame's own. What oscillates
//! more than [`SLOW_CYCLES`] times an exposure does not move an image any more (by 1/(π·cycles) of its amplitude at most) but widens it,
//! and is kept as a variance.

use nalgebra::{Unit, UnitQuaternion, Vector3};

use super::spline::RotationSpline;
use super::{JitterTable, SceneError};
use crate::coordinates::Attitude;
use crate::effects::Observation;
use crate::rng::StageKey;
use crate::units::{ARCSEC_RAD, DEG_RAD};

/// Angular rate of the Earth against the stars, rad/s (IERS Conventions 2010, table 1.2).
pub const EARTH_RATE_RAD_S: f64 = 7.292_115_0e-5;

/// Oscillations of more cycles an exposure widen images instead of moving them.
const SLOW_CYCLES: f64 = 32.0;

/// Sinusoids that stand for a band of frequencies.
const BAND_TONES: u32 = 48;

/// The key of the jitter's random numbers.
const JITTER_STAGE: u32 = 0x4a49_5454;

/// A sinusoid about the three axes.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Tone {
    frequency_hz: f64,
    amplitude_rad: [f64; 3],
    phase_rad: [f64; 3],
}

/// The course of the attitude without jitter.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Course {
    Still,
    Rate([f64; 3]),
    Curve(RotationSpline),
    /// Fast to the Earth, whose pole stands in this direction (ICRS axes).
    Earth([f64; 3]),
}

/// The camera's motion during one exposure. Times count from the middle of the exposure (of the middle row), in seconds.
#[derive(Clone, Debug, PartialEq)]
pub struct Motion {
    course: Course,
    tones: Vec<Tone>,
    /// Variances about the camera's axes of what is faster than the exposure, rad².
    fast_rad2: [f64; 3],
}

impl Default for Motion {
    fn default() -> Self {
        Self { course: Course::Still, tones: Vec::new(), fast_rad2: [0.0; 3] }
    }
}

impl Motion {
    pub(super) fn new(course: Course, jitter: Option<&JitterTable>, seed: u64, frame: u32, exposure_s: f64) -> Self {
        let mut motion = Self { course, ..Self::default() };
        if let Some(jitter) = jitter {
            motion.fast_rad2 = jitter.sigma_arcsec.map(|sigma| (sigma * ARCSEC_RAD).powi(2));
            let key = StageKey { seed, frame, stage: JITTER_STAGE };
            for (number, tone) in (0..).zip(tones(jitter, &key)) {
                let turn = |word: u32| f64::from(word) * (std::f64::consts::TAU / 4_294_967_296.0);
                let words = key.words(number, 0);
                if tone.frequency_hz * exposure_s > SLOW_CYCLES {
                    for axis in 0..3 {
                        motion.fast_rad2[axis] += 0.5 * tone.amplitude_rad[axis].powi(2);
                    }
                } else {
                    motion.tones.push(Tone { phase_rad: [turn(words[0]), turn(words[1]), turn(words[2])], ..tone });
                }
            }
        }
        motion
    }

    /// Whether nothing turns the camera.
    #[must_use]
    pub fn is_still(&self) -> bool {
        self.course == Course::Still && self.tones.is_empty()
    }

    /// The attitude so long after the middle of the exposure, `middle` being the attitude there without jitter.
    #[must_use]
    pub fn attitude(&self, middle: &Attitude, time_s: f64) -> Attitude {
        let course = match &self.course {
            Course::Still => *middle,
            Course::Rate(rate_rad_s) => middle.turned(rate_rad_s.map(|component| component * time_s)),
            Course::Curve(spline) => middle.turned(spline.at(time_s)),
            Course::Earth(pole) => {
                let turn = UnitQuaternion::from_axis_angle(&Unit::new_normalize(Vector3::from(*pole)), -EARTH_RATE_RAD_S * time_s);
                Attitude::new(middle.camera_from_icrs * turn)
            }
        };
        if self.tones.is_empty() {
            return course;
        }
        let mut turn = [0.0; 3];
        for tone in &self.tones {
            let angle = std::f64::consts::TAU * tone.frequency_hz * time_s;
            for (axis, turn) in turn.iter_mut().enumerate() {
                *turn += tone.amplitude_rad[axis] * (angle + tone.phase_rad[axis]).sin();
            }
        }
        course.turned(turn)
    }

    /// Variances about the camera's axes of motion that is faster than the exposure, rad².
    #[must_use]
    pub fn fast_rad2(&self) -> [f64; 3] {
        self.fast_rad2
    }

    /// Oscillations in so long a time, of the fastest that moves images.
    #[must_use]
    pub fn most_cycles(&self, time_s: f64) -> f64 {
        self.tones.iter().fold(0.0_f64, |most, tone| most.max(tone.frequency_hz * time_s))
    }

    /// Times between −`half_s` and `half_s` at which the course is less smooth than elsewhere.
    #[must_use]
    pub fn breaks(&self, half_s: f64) -> Vec<f64> {
        match &self.course {
            Course::Curve(spline) => spline.knots_within(half_s).to_vec(),
            _ => Vec::new(),
        }
    }

    /// In how many steps of time between −`half_s` and `half_s` the motion is to be looked at so that none of its bends is overlooked.
    #[must_use]
    pub fn steps(&self, half_s: f64) -> usize {
        let turns = match &self.course {
            Course::Still => 0.0,
            Course::Rate(rate) => 16.0 * 2.0 * half_s * rate.iter().map(|component| component * component).sum::<f64>().sqrt(),
            Course::Curve(spline) => 3.0 * (spline.knots_within(half_s).len() + 1) as f64,
            Course::Earth(_) => 16.0 * 2.0 * half_s * EARTH_RATE_RAD_S,
        };
        let cycles = self.most_cycles(2.0 * half_s);
        (turns + 6.0 * cycles).ceil().clamp(2.0, 20_000.0) as usize
    }
}

/// The sinusoids of a spectrum without their phases. A band is cut into slices of equal width; in each stands one tone at a place by chance.
fn tones(jitter: &JitterTable, key: &StageKey) -> Vec<Tone> {
    let lines = jitter.lines.iter().map(|line| Tone {
        frequency_hz: line.frequency_hz,
        amplitude_rad: line.amplitude_arcsec.map(|amplitude| amplitude * ARCSEC_RAD),
        phase_rad: [0.0; 3],
    });
    let bands = (0..).zip(&jitter.bands).flat_map(|(number, band)| {
        (0..BAND_TONES).map(move |slice| {
            let place = f64::from(key.words(slice, 1 + number)[0]) / 4_294_967_296.0;
            let share = (f64::from(slice) + place) / f64::from(BAND_TONES);
            let amplitude = (2.0 / f64::from(BAND_TONES)).sqrt() * ARCSEC_RAD;
            Tone {
                frequency_hz: band.low_hz + (band.high_hz - band.low_hz) * share,
                amplitude_rad: band.sigma_arcsec.map(|sigma| sigma * amplitude),
                phase_rad: [0.0; 3],
            }
        })
    });
    lines.chain(bands).collect()
}

/// The circumstances a little earlier or later: the zenith and the Earth turn, everything else stays.
#[must_use]
pub(super) fn later(observation: &Observation, time_s: f64) -> Observation {
    let Some(earth) = observation.earth_from_icrs else { return *observation };
    let angle = EARTH_RATE_RAD_S * time_s;
    let turn = UnitQuaternion::from_axis_angle(&Unit::new_normalize(Vector3::from(earth[2])), angle);
    let turned = |v: [f64; 3]| {
        let w = turn * Vector3::from(v);
        [w.x, w.y, w.z]
    };
    Observation { zenith: observation.zenith.map(turned), earth_from_icrs: Some(earth.map(turned)), ..*observation }
}

/// Checks `[jitter]`.
pub(super) fn check(path: &str, jitter: &JitterTable) -> Result<(), SceneError> {
    let refuse = |key: String, value: String, remedy: &'static str| Err(SceneError::Value { path: path.to_owned(), key, value, remedy });
    let amplitude = |key: String, values: [f64; 3]| {
        if values.iter().all(|value| (0.0..=36_000.0).contains(value)) {
            return Ok(());
        }
        refuse(key, format!("{values:?}"), "must be three angles between 0 and 36000 arcsec")
    };
    amplitude("jitter.sigma_arcsec".to_owned(), jitter.sigma_arcsec)?;
    let frequency = |key: String, value: f64| {
        if (1e-6..=1e6).contains(&value) { Ok(()) } else { refuse(key, value.to_string(), "must lie between 1e-6 and 1e6 Hz") }
    };
    for (index, line) in jitter.lines.iter().enumerate() {
        amplitude(format!("jitter.lines[{index}].amplitude_arcsec"), line.amplitude_arcsec)?;
        frequency(format!("jitter.lines[{index}].frequency_hz"), line.frequency_hz)?;
    }
    for (index, band) in jitter.bands.iter().enumerate() {
        amplitude(format!("jitter.bands[{index}].sigma_arcsec"), band.sigma_arcsec)?;
        frequency(format!("jitter.bands[{index}].low_hz"), band.low_hz)?;
        frequency(format!("jitter.bands[{index}].high_hz"), band.high_hz)?;
        if band.low_hz >= band.high_hz {
            return refuse(format!("jitter.bands[{index}].low_hz"), band.low_hz.to_string(), "must lie below high_hz");
        }
    }
    Ok(())
}

/// The course through attitudes at given times (s from the middle of the exposure; quaternions camera_from_icrs, scalar last), and the
/// attitude at the middle.
pub(super) fn through(samples: &[[f64; 5]], half_s: f64) -> Result<(Attitude, Course), &'static str> {
    /// The curve is drawn in the tangent space of the middle attitude; it must stay away from the half turn where that ends.
    const WIDEST_RAD: f64 = 150.0 * DEG_RAD;
    const TOO_FAR: &str = "must stay within 150 degrees of the attitude at the middle of the exposure";
    let length = |q: &[f64]| q.iter().map(|component| component * component).sum::<f64>().sqrt();
    if samples.len() < 2 || samples.windows(2).any(|pair| pair[1][0].partial_cmp(&pair[0][0]) != Some(std::cmp::Ordering::Greater)) {
        return Err("must be two samples or more, [seconds from the middle, i, j, k, w], with rising times");
    }
    if samples.iter().any(|sample| !sample.iter().all(|number| number.is_finite()) || (length(&sample[1..]) - 1.0).abs() > 0.01) {
        return Err("must hold unit quaternions [i, j, k, w] behind each time");
    }
    if samples[0][0] > -half_s || samples[samples.len() - 1][0] < half_s {
        return Err("must reach from the start to the end of the exposure, with a rolling shutter of all rows");
    }
    let attitude = |sample: &[f64; 5]| Attitude::from([sample[1], sample[2], sample[3], sample[4]]);
    let nearest = attitude(samples.iter().min_by(|a, b| a[0].abs().total_cmp(&b[0].abs())).unwrap_or(&samples[0]));
    let curve = |from: &Attitude| -> Option<RotationSpline> {
        let turns: Vec<[f64; 3]> = samples
            .iter()
            .map(|sample| {
                let turn = -(attitude(sample).camera_from_icrs * from.camera_from_icrs.inverse()).scaled_axis();
                [turn.x, turn.y, turn.z]
            })
            .collect();
        let near = turns.iter().all(|turn| length(turn) < WIDEST_RAD);
        near.then(|| RotationSpline::new(samples.iter().map(|sample| sample[0]).collect(), turns))
    };
    let middle = nearest.turned(curve(&nearest).ok_or(TOO_FAR)?.at(0.0));
    Ok((middle, Course::Curve(curve(&middle).ok_or(TOO_FAR)?)))
}

impl Course {
    /// The rate of the camera in its own axes at the middle of the exposure, where the course is the camera's own.
    pub(super) fn rate_rad_s(&self) -> Option<[f64; 3]> {
        match self {
            Self::Rate(rate) => Some(*rate),
            Self::Curve(spline) => Some(spline.rate_at(0.0)),
            Self::Still | Self::Earth(_) => None,
        }
    }
}
