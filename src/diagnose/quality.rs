//! Quality of fit of a model, and which star images took part.

use super::crossfit::CrossFit;
use super::diagnosis::{FitQuality, MeasuredNoise, NoiseState, ResidualRow, StarsUsed, Unused};
use super::evidence::Evidence;
use super::fit_state::{FitState, SelectedEffect};
use super::linear_system::{Whitened, dot};
use super::noise::NoiseModel;
use super::options::DiagnoseOptions;
use crate::identify::ControlPoints;
use crate::statistics::student_t::{psi_of, weight};

/// How well a model does, with the noise of the final one; on held-out frames what each turn chose itself of the effects `named`.
pub(super) fn quality(evidence: &Evidence, stand: &FitState, noise: &NoiseModel, tried: &CrossFit, named: &[SelectedEffect]) -> FitQuality {
    let residual_px = stand.noise.unwhiten(&evidence.images, &evidence.place, &stand.fit.residual);
    let used: Vec<usize> = (0..evidence.images.len()).filter(|k| stand.take[*k]).collect();
    let square: f64 = used.iter().map(|k| residual_px[2 * k].powi(2) + residual_px[2 * k + 1].powi(2)).sum();
    let stated: f64 = used.iter().map(|k| evidence.images[*k].stated_px2[0] + evidence.images[*k].stated_px2[2]).sum();
    // What attitudes and camera take of the errors is missing in the residuals.
    let free = stand.fit.degrees / (2 * used.len()).max(1) as f64;
    let white: Whitened = {
        let pairs = residual_px.chunks_exact(2).map(|pair| [pair[0], pair[1]]).collect();
        evidence.white(noise, &pairs)
    };
    let (psi, _) = psi_of(&white, &stand.take, noise.tail_degrees);
    let held = {
        let judged = FitState { noise: noise.clone(), system: evidence.system(noise), ..stand.clone() };
        tried.quality(evidence, &judged, named)
    };
    FitQuality {
        rms_px: (square / used.len().max(1) as f64).sqrt(),
        expected_rms_px: (!used.is_empty()).then(|| (stated / used.len() as f64 * free).sqrt()),
        chi2_per_dof: dot(&psi, &white) / stand.fit.degrees,
        held_out_rms_px: held.map(|(_, rms)| rms),
        held_out_chi2_per_dof: held.map(|(chi, _)| chi),
    }
}

/// The star images that took part.
pub(super) fn stars_used(evidence: &Evidence, points: &ControlPoints, stand: &FitState) -> StarsUsed {
    let mut used = StarsUsed { left_out: points.points.len() - stand.take.iter().filter(|take| **take).count(), ..StarsUsed::default() };
    for (image, _) in evidence.images.iter().zip(&stand.take).filter(|(_, take)| **take) {
        if points.points[image.point].has_proper_motion {
            used.with_proper_motion += 1;
        } else {
            used.without += 1;
        }
    }
    used
}

/// Why star images took no part.
pub(super) fn unused(evidence: &Evidence, points: &ControlPoints, stand: &FitState, options: &DiagnoseOptions) -> Vec<Unused> {
    let far = stand.take.iter().filter(|take| !**take).count();
    let unmoving = if options.proper_motion_only { points.points.iter().filter(|point| !point.has_proper_motion).count() } else { 0 };
    let others = points.points.len().saturating_sub(evidence.images.len() + unmoving);
    [
        (unmoving, "the catalogue has no proper motion of their stars (--all-stars takes them too)"),
        (far, "too far from where the model has them to be images of their stars"),
        (others, "the fit of the camera could not use them"),
    ]
    .into_iter()
    .filter(|(images, _)| *images > 0)
    .map(|(images, reason)| Unused { images, reason: reason.to_owned() })
    .collect()
}

/// The noise, for the result.
pub(super) fn noise_state(stand: &FitState) -> NoiseState {
    let wrong = stand.take.iter().filter(|take| !**take).count() as f64 / stand.take.len().max(1) as f64;
    NoiseState {
        floor_px: stand.noise.floor_px2.sqrt(),
        variance_factor: stand.noise.factor,
        tail_degrees: Some(stand.noise.tail_degrees).filter(|degrees| degrees.is_finite()),
        wrong_share: wrong,
        measured: MeasuredNoise::default(),
    }
}

/// Residuals of every star image before and after.
pub(super) fn residual_rows(evidence: &Evidence, before: &FitState, after: &FitState, points: &ControlPoints) -> Vec<ResidualRow> {
    let px = |stand: &FitState| stand.noise.unwhiten(&evidence.images, &evidence.place, &stand.everywhere());
    let (before_px, after_px) = (px(before), px(after));
    let of = |(k, image): (usize, &crate::calibrate::BundleImage)| {
        let point = &points.points[image.point];
        let q = after.fit.residual[2 * k].powi(2) + after.fit.residual[2 * k + 1].powi(2);
        ResidualRow {
            point: image.point,
            frame: image.frame,
            hip: point.hip,
            x_px: point.x_px,
            y_px: point.y_px,
            before_px: [before_px[2 * k], before_px[2 * k + 1]],
            after_px: [after_px[2 * k], after_px[2 * k + 1]],
            sigma_px: after.noise.sigma_px(image, evidence.place[k]),
            weight: if after.take[k] { weight(after.noise.tail_degrees, q) } else { 0.0 },
        }
    };
    evidence.images.iter().enumerate().map(of).collect()
}
