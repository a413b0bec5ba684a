//! First stage: the recording held against the model without any finding.

use std::sync::Arc;

use crate::calibrate::{BundleSolution, CalibrateOptions};
use crate::camera::Term;
use crate::diagnose::error::DiagnoseError;
use crate::diagnose::evidence::Evidence;
use crate::diagnose::final_fit::solve_again;
use crate::diagnose::fit_state::FitState;
use crate::diagnose::noise::NoiseModel;
use crate::diagnose::options::{DiagnoseOptions, Telemetry};
use crate::diagnose::rendered_columns::{self, Rendered};
use crate::diagnose::star_images::StarImages;
use crate::identify::ControlPoints;

/// Fewer numbers beyond the parameters say nothing.
const MIN_DEGREES: f64 = 20.0;

/// The recording as the diagnosis works on it.
pub(in crate::diagnose) struct Baseline<'a> {
    pub(in crate::diagnose) points: &'a ControlPoints,
    pub(in crate::diagnose) telemetry: &'a Telemetry,
    /// As given, but that `physics` names what stands beside too.
    pub(in crate::diagnose) options: DiagnoseOptions,
    /// The effects that the model was asked to contain.
    pub(in crate::diagnose) physics: Vec<String>,
    /// Effects that stand in the model beside those, at their known sizes.
    pub(in crate::diagnose) known: Vec<Term>,
    /// Camera and attitudes.
    pub(in crate::diagnose) joint: BundleSolution,
    /// The linear problem there.
    pub(in crate::diagnose) evidence: Evidence,
    /// Every image allowed.
    pub(in crate::diagnose) all: Vec<bool>,
    /// The errors as stated, where every fit begins.
    pub(in crate::diagnose) stated: NoiseModel,
    /// All images fitted with attitudes and camera alone.
    pub(in crate::diagnose) fit: FitState,
}

impl<'a> Baseline<'a> {
    /// Fits camera and attitudes.
    pub(in crate::diagnose) fn new(
        points: &'a ControlPoints,
        telemetry: &'a Telemetry,
        options: &DiagnoseOptions,
    ) -> Result<Self, DiagnoseError> {
        let solve = CalibrateOptions {
            solve: options.solve.clone(),
            leave_out_imprecise: false,
            proper_motion_only: options.proper_motion_only,
            held_out: false,
            physics: options.physics.clone(),
            terms: options.terms.clone(),
            ..CalibrateOptions::default()
        };
        let joint = BundleSolution::solve(points, &solve)?;
        let columns = Rendered::new(&StarImages::new(&joint), &joint, points, options.looks.as_ref());
        let evidence = Evidence::at(&joint, points, telemetry, options, Arc::new(columns));
        let all = vec![true; evidence.images.len()];
        let stated = NoiseModel::stated(evidence.frame_factors.clone());
        let fit = FitState::new(&evidence, &all, &[], &stated);
        if fit.fit.degrees < MIN_DEGREES {
            return Err(DiagnoseError::TooFew { images: evidence.images.len(), frames: evidence.frames.len() });
        }
        let (physics, options) = (options.physics.clone(), options.clone());
        Ok(Self { points, telemetry, options, physics, known: Vec::new(), joint, evidence, all, stated, fit })
    }

    /// The same with effects in the model at their known sizes.
    pub(in crate::diagnose) fn with_known(mut self, known: Vec<Term>) -> Result<Self, DiagnoseError> {
        if known.is_empty() {
            return Ok(self);
        }
        self.options.physics.extend(known.iter().map(|term| term.effect.clone()));
        let joint = solve_again(&self.joint, &self.options, &self.evidence, &self.fit, &known, &[])?;
        let evidence = Evidence::at(&joint, self.points, self.telemetry, &self.options, self.evidence.rendered.clone());
        let fit = FitState::new(&evidence, &self.all, &[], &self.stated);
        Ok(Self { known, joint, evidence, fit, ..self })
    }

    /// What its reader has to know.
    pub(in crate::diagnose) fn warnings(&self) -> Vec<String> {
        let mut warnings = self.joint.notes().to_vec();
        warnings.extend(rendered_columns::left_out(&self.evidence, self.options.looks.as_ref()));
        if !self.known.is_empty() {
            let ids: Vec<&str> = self.known.iter().map(|term| term.effect.as_str()).collect();
            warnings.push(format!(
                "the model holds {} at the size that place and time tell, beside other effects of nature that were left out: by itself it is too weak to show here",
                ids.join(", ")
            ));
        }
        warnings
    }
}
