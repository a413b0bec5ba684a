//! The diagnosis's claims are statistics: p-values where there is nothing, sizes with errors where there is something.

use boresight::calibrate::trial::Trial;
use boresight::catalog::Catalog;
use boresight::diagnose::{DiagnoseOptions, Diagnosis, EffectState, Verdict, diagnose};
use boresight::effects::StarState;
use boresight::identify::ControlPoints;
use rayon::prelude::*;

/// A night of 20 frames of the published camera at 0.1 px, with what `displace` adds to each measured point: (colour offset, x and y from
/// the middle in px) → px.
fn night(seed: u64, displace: impl Fn(f64, [f64; 2]) -> [f64; 2]) -> ControlPoints {
    let trial = Trial { frames: 20, ..Trial::published() };
    let mut points = trial.night(Catalog::embedded(), seed).control_points;
    for point in &mut points.points {
        let colour = point.colour.map_or(0.0, |colour| colour - StarState::REFERENCE_COLOUR);
        let [dx, dy] = displace(colour, [point.x_px - 511.5, point.y_px - 511.5]);
        point.x_px += dx;
        point.y_px += dy;
    }
    points
}

fn diagnosed(points: &ControlPoints, seed: u64) -> Diagnosis {
    diagnose(points, &Vec::new(), &DiagnoseOptions { nulls: 200, seed, ..DiagnoseOptions::default() }).unwrap()
}

/// Where nothing is missing nothing is named, and the p-values are no smaller than those of chance.
#[test]
fn nothing_is_found_where_nothing_is_missing() {
    const NIGHTS: u64 = 60;
    let found: Vec<Diagnosis> = (0..NIGHTS).into_par_iter().map(|seed| diagnosed(&night(900 + seed, |_, _| [0.0; 2]), seed)).collect();
    assert!(found.iter().all(|diagnosis| diagnosis.verdict == Verdict::Consistent && diagnosis.findings.is_empty()));
    let p: Vec<f64> = found.iter().map(|diagnosis| diagnosis.channels.astrometry.as_ref().unwrap().p_value).collect();
    for (limit, most) in [(0.02, 6), (0.1, 15), (0.3, 33)] {
        // Binomial of 60: chance exceeds these counts with less than 1e-3.
        let below = p.iter().filter(|p| **p < limit).count();
        assert!(below <= most, "{below} of {NIGHTS} below {limit}");
    }
    assert!(p.iter().filter(|p| **p < 0.6).count() >= 10, "p-values that are always large are no test: {p:?}");
}

/// A lateral colour is named, located and measured, with an error that is its scatter over nights.
#[test]
fn a_colour_that_scales_is_named_and_measured() {
    const NIGHTS: u64 = 16;
    const SCALE: f64 = 4e-4;
    let found: Vec<Diagnosis> = (0..NIGHTS)
        .into_par_iter()
        .map(|seed| diagnosed(&night(300 + seed, |colour, [x, y]| [SCALE * colour * x, SCALE * colour * y]), seed))
        .collect();
    let mut square = 0.0;
    for (seed, diagnosis) in found.iter().enumerate() {
        let ids: Vec<&str> = diagnosis.findings.iter().map(|finding| finding.id.as_str()).collect();
        assert_eq!((diagnosis.verdict, ids.as_slice()), (Verdict::Explained, ["lateral-colour"].as_slice()), "night {seed}");
        let finding = &diagnosis.findings[0];
        assert_eq!(finding.located_by[0], "colour");
        assert!(finding.held_out_delta_chi2 > 0.0 && diagnosis.fit.after.rms_px < diagnosis.fit.baseline.rms_px);
        square += ((finding.parameters[0].value - SCALE) / finding.parameters[0].sigma).powi(2);
    }
    let pulls = (square / NIGHTS as f64).sqrt();
    // χ² of 16: 0.53 … 1.55 with 99.9 %.
    assert!((0.53..1.55).contains(&pulls), "{pulls}");
}

/// What attitudes take up is not claimed, and what the recording lacks is said.
#[test]
fn what_cannot_be_seen_is_said() {
    let diagnosis = diagnosed(&night(77, |_, _| [0.3, -0.2]), 1);
    let state = |id: &str| diagnosis.effects.iter().find(|effect| effect.id == id).unwrap();
    assert_eq!(diagnosis.verdict, Verdict::Consistent, "a shift of the whole image is an attitude");
    assert_eq!(state("frame-rotation").status, EffectState::NotObservable);
    for id in ["thermal-focal-length", "rolling-shutter", "parallax"] {
        assert_eq!(state(id).status, EffectState::NotApplicable, "{id}");
        assert!(!state(id).reason.is_empty());
    }
    let limit = state("pixel-aspect").upper_limit_95.as_ref().unwrap();
    assert!(limit.value > 0.0 && limit.value < 1e-3, "{limit:?}");
}

/// The same recording and seed give the same diagnosis, whatever the number of threads.
#[test]
fn a_diagnosis_is_reproducible() {
    let points = night(5, |_, [x, y]| [2e-4 * x, -2e-4 * y]);
    let of = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let mut diagnosis = pool.install(|| diagnosed(&points, 9));
        diagnosis.seconds = 0.0;
        serde_json::to_string(&diagnosis).unwrap()
    };
    assert_eq!(of(1), of(3));
}
