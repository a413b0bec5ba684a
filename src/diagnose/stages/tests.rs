//! Each stage on a fabricated linear problem: the night of a simulated camera with a hypothesis' own column, times a size, added to its stars.

use super::{Baseline, Judged, Reported, Screened, Selected, Solved, Validated};
use crate::calibrate::trial::Trial;
use crate::catalog::Catalog;
use crate::diagnose::Verdict;
use crate::diagnose::cross_validation::Confirmed;
use crate::diagnose::error::DiagnoseError;
use crate::diagnose::fit_state::SelectedEffect;
use crate::diagnose::options::{DiagnoseOptions, Telemetry};
use crate::effects::ids;
use crate::identify::ControlPoints;

const HIDDEN: &str = ids::PIXEL_ASPECT;
/// Standard deviations of what is hidden, attitudes and camera fitted.
const STRONG: f64 = 15.0;

fn options() -> DiagnoseOptions {
    DiagnoseOptions { nulls: 200, ..DiagnoseOptions::default() }
}

fn night() -> ControlPoints {
    let trial = Trial { frames: 8, stars_per_frame: 40, noise_px: 0.05, attitude_sigma_rad: None, wrong_share: 0.0, ..Trial::published() };
    let night = trial.night(Catalog::embedded(), 11);
    ControlPoints { attitudes: night.attitudes.iter().map(|attitude| Some(*attitude)).collect(), ..night.control_points }
}

fn baseline<'a>(points: &'a ControlPoints, telemetry: &'a Telemetry) -> Baseline<'a> {
    Baseline::new(points, telemetry, &options()).unwrap()
}

/// The night with the hypothesis' column at so many standard deviations in the frames for which `shown` is true.
fn hidden(sigmas: f64, shown: impl Fn(usize) -> bool) -> (ControlPoints, f64) {
    let (points, telemetry) = (night(), Telemetry::new());
    let baseline = baseline(&points, &telemetry);
    let entry = entry(&baseline);
    let column = &baseline.evidence.hypotheses[entry.hypothesis].variants[entry.variant].columns[0];
    let rest = baseline.fit.fit.project(&baseline.fit.white(&baseline.evidence, &[entry])[0]);
    let size = sigmas / rest.iter().map(|value| value * value).sum::<f64>().sqrt();
    let mut with = points.clone();
    for (image, [x, y]) in baseline.evidence.images.iter().zip(column).filter(|(image, _)| shown(image.frame)) {
        // A column is the change of the residual, measured less modelled.
        with.points[image.point].x_px -= size * x;
        with.points[image.point].y_px -= size * y;
    }
    (with, size)
}

fn entry(baseline: &Baseline) -> SelectedEffect {
    let hypothesis = baseline.evidence.hypotheses.iter().position(|own| own.id() == HIDDEN).unwrap();
    SelectedEffect { hypothesis, variant: 0 }
}

/// The baseline fits noise to its own size, and refuses what has no degrees of freedom left.
#[test]
fn the_baseline_is_the_camera_alone() {
    let (points, telemetry) = (night(), Telemetry::new());
    let fitted = baseline(&points, &telemetry);
    assert!((fitted.fit.noise.factor.sqrt() - 1.0).abs() < 0.15, "{:?}", fitted.fit.noise);
    assert!(fitted.known.is_empty() && fitted.physics.is_empty());
    let mut few = points.clone();
    few.points.retain(|point| point.frame == 0);
    few.points.truncate(9);
    let refused = Baseline::new(&few, &telemetry, &options());
    assert!(matches!(refused, Err(DiagnoseError::TooFew { .. } | DiagnoseError::Baseline(_))));
}

/// The screening is silent where nothing is hidden and significant where something is.
#[test]
fn screening_tells_a_mismatch_from_none() {
    let telemetry = Telemetry::new();
    let points = night();
    let none = Screened::new(&baseline(&points, &telemetry));
    assert!(!none.significant && none.test.p_value > 0.01, "{}", none.test.p_value);
    let (points, _) = hidden(STRONG, |_| true);
    let some = Screened::new(&baseline(&points, &telemetry));
    assert!(some.significant && some.test.p_value < 1e-6, "{}", some.test.p_value);
    assert!(!some.located.is_empty() && some.threshold > some.hypotheses.ln());
}

/// All images propose what is hidden and nothing else; nothing where nothing is missing.
#[test]
fn selection_proposes_what_is_hidden() {
    let telemetry = Telemetry::new();
    let (points, _) = hidden(STRONG, |_| true);
    let with = baseline(&points, &telemetry);
    let screened = Screened::new(&with);
    assert_eq!(Selected::new(&with, &screened).proposals, vec![entry(&with)]);
    let silent = Screened { significant: false, ..screened };
    assert!(Selected::new(&with, &silent).proposals.is_empty());
}

/// Images that took no part confirm what is in all frames, and not what is in one.
#[test]
fn validation_confirms_what_all_frames_show() {
    let telemetry = Telemetry::new();
    for (everywhere, points) in [(true, hidden(STRONG, |_| true).0), (false, hidden(4.0 * STRONG, |frame| frame == 3).0)] {
        let with = baseline(&points, &telemetry);
        let screened = Screened::new(&with);
        let proposals = vec![entry(&with)];
        let validated = Validated::new(&with, &screened, Selected { proposals: proposals.clone() });
        let Confirmed { entries, proofs, withheld } = &validated.confirmed;
        if everywhere {
            assert_eq!((entries, withheld.len()), (&proposals, 0));
            assert!(proofs[0].gain.delta_chi2 > 0.5 * STRONG * STRONG, "{:?}", proofs[0]);
        } else {
            assert_eq!((entries.len(), withheld.len()), (0, 1), "{proofs:?}");
        }
    }
}

/// Solved without linearisation the size is what was hidden, and nothing is left.
#[test]
fn the_solution_has_the_size_and_leaves_nothing() {
    let telemetry = Telemetry::new();
    let (points, size) = hidden(STRONG, |_| true);
    let with = baseline(&points, &telemetry);
    let screened = Screened::new(&with);
    let validated = Validated::new(&with, &screened, Selected { proposals: vec![entry(&with)] });
    let solved = Solved::new(validated).unwrap().with_remainder().unwrap();
    let variant = &with.evidence.hypotheses[entry(&with).hypothesis].variants[0];
    let found = &solved.fit.parameters(0, variant)[0];
    assert!((found.value - size).abs() < 4.0 * found.sigma && found.sigma < size / 10.0, "{found:?} for {size}");
    let (_, left) = solved.left.as_ref().unwrap();
    assert!(left.p_value > options().alpha, "{}", left.p_value);
    // Without it in force it is what is left.
    let without = Validated::new(&with, &screened, Selected { proposals: Vec::new() });
    let rest = Solved::new(without).unwrap();
    assert!(rest.entries().is_empty() && rest.left.is_none());
    assert_eq!(rest.with_remainder().unwrap().entries(), &[entry(&with)], "what is left is proposed, and confirmed");
}

/// A name stands where all frames show it, and not where one frame carries it.
#[test]
fn a_name_that_one_frame_carries_is_vetoed() {
    let telemetry = Telemetry::new();
    for (everywhere, points) in [(true, hidden(STRONG, |_| true).0), (false, hidden(4.0 * STRONG, |frame| frame == 3).0)] {
        let with = baseline(&points, &telemetry);
        let screened = Screened::new(&with);
        let mut validated = Validated::new(&with, &screened, Selected { proposals: vec![entry(&with)] });
        // As if it had been confirmed.
        let proofs = [std::mem::take(&mut validated.confirmed.proofs), Vec::new()].concat();
        validated.confirmed = Confirmed { entries: vec![entry(&with)], proofs, withheld: Vec::new() };
        let solved = Solved::new(validated).unwrap();
        let judged = Judged::new(&solved);
        assert_eq!(judged.vetoes.is_empty(), everywhere, "{:?}", judged.vetoes);
        assert_eq!(judged.standing().len(), usize::from(everywhere));
        assert_eq!(judged.withheld().len(), usize::from(!everywhere));
        if !everywhere {
            assert!(judged.vetoes[0].1.iter().any(|against| against.contains("frame 3")), "{:?}", judged.vetoes);
        }
    }
}

/// The report names what stands; where nothing is hidden it names nothing.
#[test]
fn the_report_names_what_stands() {
    let telemetry = Telemetry::new();
    for (points, expected) in [(hidden(STRONG, |_| true).0, vec![HIDDEN]), (night(), Vec::new())] {
        let with = baseline(&points, &telemetry);
        let screened = Screened::new(&with);
        let selected = Selected::new(&with, &screened);
        let solved = Solved::new(Validated::new(&with, &screened, selected)).unwrap().with_remainder().unwrap();
        let judged = Judged::new(&solved);
        let diagnosis = Reported::new(&judged).unwrap().diagnosis(&|_| ());
        assert_eq!(diagnosis.findings.iter().map(|finding| finding.id.as_str()).collect::<Vec<_>>(), expected);
        let is_explained = diagnosis.verdict == Verdict::Explained;
        assert_eq!(is_explained, !expected.is_empty(), "{:?}", diagnosis.verdict);
        assert!(diagnosis.unknown.is_empty() && diagnosis.camera.is_some());
    }
}
