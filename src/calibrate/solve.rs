//! From control points to a calibration, by the method that is asked for.

use super::calibration::Calibration;
use super::check::{check_points, free_of_reference_model};
use super::error::CalibrateError;
use super::geometry::Scaling;
use super::options::{CalibrateOptions, Method};
use super::pair_methods::solve_pairs;
use super::{bundle, select, summary, uncertainty};
use crate::effects::ids;
use crate::identify::ControlPoints;

/// Whether the joint method can solve for what this name means: a parameter of the reference model, an effect, or `effect.parameter`.
pub fn check_parameter_name(name: &str) -> Result<(), CalibrateError> {
    bundle::check_name(name)
}

/// Calibrates a camera.
///
/// ```no_run
/// use boresight::calibrate::{CalibrateOptions, calibrate};
/// use boresight::camera::Physics;
/// use boresight::catalog::Catalog;
/// use boresight::identify::IdentifyOptions;
/// use boresight::pipeline::{self, MeasureOptions};
/// use boresight::recording::Recording;
///
/// let measured = pipeline::measure(Recording::open(&["night"])?, &MeasureOptions::default(), || ())?;
/// let catalog = Catalog::embedded();
/// let identified = pipeline::identify_frames(&measured, catalog, &Physics::Known.into(), &IdentifyOptions::default(), || ())?;
/// let points = pipeline::control_points(&measured, &identified, catalog, None, false)?.points;
/// for parameter in calibrate(&points, &CalibrateOptions::default())?.parameters {
///     println!("{} = {} ± {} {}", parameter.name, parameter.value, parameter.sigma, parameter.unit);
/// }
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn calibrate(control_points: &ControlPoints, options: &CalibrateOptions) -> Result<Calibration, CalibrateError> {
    check_points(control_points, options)?;
    let nominal = control_points.nominal;
    let selection = select::select(control_points, options);
    let usable: usize = selection.frames.iter().map(|frame| frame.stars.len()).sum();
    if usable == 0 {
        return Err(CalibrateError::TooFewPoints { offered: control_points.points.len(), usable, frames: selection.frames.len() });
    }
    if options.method == Method::Bundle {
        return bundle::calibrate(control_points, options, &selection);
    }
    let for_bundle = [
        ("priors", !options.priors.is_empty()),
        ("select_model", options.select_model),
        ("extend_model", options.extend_model),
        ("projection", options.projection != ids::PINHOLE),
        ("terms", !options.terms.is_empty()),
    ];
    if let Some((name, _)) = for_bundle.into_iter().find(|(_, given)| *given) {
        return Err(CalibrateError::BadOption {
            name,
            value: options.method.name().to_owned(),
            allowed: "only the method bundle can use it",
        });
    }
    let scaling = Scaling::of(&nominal, free_of_reference_model(options)?);
    let coverage = uncertainty::coverage(&selection.frames, &nominal, &scaling)?.checked()?;
    let solution = solve_pairs(&selection.frames, &nominal, &scaling, options)?;
    summary::summarise(control_points, options, &selection, &scaling, &coverage, &solution)
}
