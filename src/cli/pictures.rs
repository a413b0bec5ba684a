//! Pictures of results.

use std::path::Path;

use anyhow::{Context, Result};
use boresight::calibrate::{Calibration, Comparison, MapChange, residuals_px};
use boresight::coordinates::{Direction, PixelPoint};
use boresight::report;
use boresight::units::ARCSEC_RAD;

/// Residual vectors with the camera before (as the recording declares it) and after the calibration, side by side.
pub(crate) fn residuals(path: &Path, calibration: &Calibration) -> Result<()> {
    let panel = |title: &str, residuals: Vec<Option<[f64; 2]>>| {
        let vectors: Vec<report::Vector> = calibration
            .points
            .iter()
            .zip(residuals)
            .filter_map(|(point, residual)| {
                let [dx_px, dy_px] = residual?;
                Some(report::Vector {
                    x_px: calibration.stored_column_px(point.x_px),
                    y_px: point.y_px,
                    dx_px: dx_px * f64::from(calibration.parity),
                    dy_px,
                    rejected: point.weight <= 0.5,
                })
            })
            .collect();
        report::VectorPanel { title: title.to_owned(), vectors, told: None }
    };
    let before = &calibration.control_points.nominal;
    // With all that was solved for: a camera's own parameters are only a part of a lens with higher terms.
    let mut solved = panel("after", calibration.points.iter().map(|point| point.residual_px).collect());
    solved.told =
        calibration.rms_px.map(|rms_px| report::FitNumbers { rms_px, stars: calibration.stars, rejected: calibration.rejected.len() });
    let mut declared = panel("before (camera as declared)", residuals_px(calibration, before));
    // The same points are rejected in both.
    let kept: Vec<f64> = declared.vectors.iter().filter(|v| !v.rejected).map(|v| v.dx_px.powi(2) + v.dy_px.powi(2)).collect();
    declared.told = Some(report::FitNumbers {
        rms_px: (kept.iter().sum::<f64>() / kept.len().max(1) as f64).sqrt(),
        stars: kept.len(),
        rejected: calibration.rejected.len(),
    });
    let panels = [&declared, &solved];
    let size = (before.width_px, before.height_px);
    Ok(report::residual_vectors(path, "Residuals of the stars, one free attitude a frame", size, panels)?)
}

/// Points along each side of the maps that are drawn.
const MAP_SIDE: usize = 41;

/// Three significant digits, plain where that is short.
pub(crate) fn significant(number: f64) -> String {
    if number == 0.0 || !number.is_finite() {
        return format!("{}", number + 0.0); // no −0
    }
    let digits = (2.0 - number.abs().log10().floor()).clamp(0.0, 9.0) as usize;
    if number.abs() < 1e-4 { format!("{number:.1e}") } else { format!("{number:.digits$}") }
}

/// How many arcsec a pixel is across in the middle of the frame.
pub(crate) fn arcsec_per_px(calibration: &Calibration) -> Option<f64> {
    let chain = calibration.full_chain();
    let (camera, context) = (chain.camera(), chain.reference_context());
    let [x_px, y_px] = [camera.width_px, camera.height_px].map(|length| (length as f64 - 1.0) / 2.0);
    let at = |dx: f64, dy: f64| chain.direction(PixelPoint { x_px: x_px + dx, y_px: y_px + dy }, &context);
    let across = |a: Option<Direction<_>>, b: Option<Direction<_>>| Some(a?.angle_rad(&b?));
    let mean = f64::midpoint(across(at(-0.5, 0.0), at(0.5, 0.0))?, across(at(0.0, -0.5), at(0.0, 0.5))?);
    Some(mean / ARCSEC_RAD).filter(|scale| scale.is_finite() && *scale > 0.0)
}

/// Values at points of the grid of `side` × `side` over a frame of this size, row by row; not a number where there is none.
fn on_grid(size: [usize; 2], side: usize, points: impl Iterator<Item = (PixelPoint, f64)>) -> Vec<f64> {
    let mut values = vec![f64::NAN; side * side];
    let along = |px: f64, length: usize| (px / (length as f64 - 1.0) * (side as f64 - 1.0)).round().max(0.0) as usize;
    for (pixel, value) in points {
        if let Some(place) = values.get_mut(along(pixel.y_px, size[1]) * side + along(pixel.x_px, size[0])) {
            *place = value;
        }
    }
    values
}

/// The standard error of the map over the frame, with the star images used. Where the calibration tells none there is no file, nor one left
/// from before.
pub(crate) fn map_sigma(path: &Path, calibration: &Calibration) -> Result<()> {
    let Some(sigma) = boresight::calibrate::map_sigma(calibration, MAP_SIDE) else {
        return match std::fs::remove_file(path) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                Err(error).with_context(|| format!("removing the former {}", path.display()))
            }
            _ => Ok(()),
        };
    };
    let told = calibration.map_sigma_px.unwrap_or_else(|| {
        let mut sorted: Vec<f64> = sigma.iter().map(|(_, sigma)| *sigma).collect();
        sorted.sort_by(f64::total_cmp);
        boresight::calibrate::MapSigma { median: sorted[sorted.len() / 2], max: sorted[sorted.len() - 1] }
    });
    let size = [calibration.camera.width_px, calibration.camera.height_px];
    let values = on_grid(size, MAP_SIDE, sigma.into_iter());
    let scale = arcsec_per_px(calibration);
    let both = |px: f64| match scale {
        Some(scale) => format!("{} px ({} arcsec)", significant(px), significant(px * scale)),
        None => format!("{} px", significant(px)),
    };
    let used = calibration.points.iter().filter(|point| point.left_out.is_none() && point.weight > 0.5);
    let dots: Vec<[f64; 2]> = used.map(|point| [calibration.stored_column_px(point.x_px), point.y_px]).collect();
    let map = report::FieldMap {
        title: "Standard error of the map from pixel to direction".to_owned(),
        summary: format!("median {}, maximum {}", both(told.median), both(told.max)),
        values,
        side: MAP_SIDE,
        unit: "σ / px".to_owned(),
        second_unit: scale.map(|scale| ("σ / arcsec".to_owned(), scale)),
        note: format!(
            "2-D, the best rotation taken out; dots: the {} star images used{}",
            dots.len(),
            if calibration.lit.is_some() { "; nothing is said beyond them, where the lens gives no light" } else { "" }
        ),
        dots,
        ..report::FieldMap::default()
    };
    Ok(map.write(path, (calibration.camera.width_px, calibration.camera.height_px))?)
}

/// Where the map has changed between two calibrations, over how significant that is.
pub(crate) fn difference(path: &Path, [first, second]: [&Calibration; 2], comparison: &Comparison) -> Result<()> {
    /// Arrows begin that many points of the grid from the edge, and stand twice as far from each other.
    const ARROW_MARGIN: usize = 2;
    /// A map that differs by less everywhere does so by its rounding.
    const ROUNDING_PX: f64 = 1e-8;
    let change = boresight::calibrate::map_change(first, second, MAP_SIDE)?;
    let size = [first.camera.width_px, first.camera.height_px];
    let known = change.iter().any(|point| point.significance().is_some_and(f64::is_finite));
    let value = |point: &MapChange| if known { point.significance().unwrap_or(f64::NAN) } else { point.dx_px.hypot(point.dy_px) };
    let pixel = |point: &MapChange| PixelPoint { x_px: point.x_px, y_px: point.y_px };
    let values = on_grid(size, MAP_SIDE, change.iter().map(|point| (pixel(point), value(point))));
    let has_arrow = |px: f64, length: usize| {
        let index = (px / (length as f64 - 1.0) * (MAP_SIDE as f64 - 1.0)).round() as usize;
        index >= ARROW_MARGIN && (index - ARROW_MARGIN).is_multiple_of(2 * ARROW_MARGIN)
    };
    let mut arrows: Vec<report::Vector> = change
        .iter()
        .filter(|point| has_arrow(point.x_px, size[0]) && has_arrow(point.y_px, size[1]))
        .map(|point| report::Vector { x_px: point.x_px, y_px: point.y_px, dx_px: point.dx_px, dy_px: point.dy_px, rejected: false })
        .collect();
    if comparison.max_px < ROUNDING_PX {
        arrows.clear();
    }
    let p_value = comparison.p_value.map_or_else(|| "no p-value".to_owned(), |p| format!("p = {}", probability(p)));
    let map = report::FieldMap {
        title: "Change of the camera, second − first".to_owned(),
        summary: format!(
            "rms {} px, maximum {} px over the frame; {p_value}",
            significant(comparison.rms_px),
            significant(comparison.max_px)
        ),
        values,
        side: MAP_SIDE,
        // Below one standard error nothing has changed, and rounding is no change at all.
        reach: if known { vec![0.0, 1.0] } else { vec![0.0] },
        unit: if known { "length / σ" } else { "length / px" }.to_owned(),
        note: if arrows.is_empty() {
            "the maps are the same but for rounding"
        } else {
            "arrows: how far the images of stars have moved, the best rotation taken out"
        }
        .to_owned(),
        arrows,
        ..report::FieldMap::default()
    };
    Ok(map.write(path, (first.camera.width_px, first.camera.height_px))?)
}

/// A probability with as many digits as it deserves.
pub(crate) fn probability(p: f64) -> String {
    match p {
        p if p >= 0.001 => format!("{p:.3}"),
        p if p > 1e-300 => format!("{p:.0e}"),
        _ => "0 (below 1e-300)".to_owned(),
    }
}

/// A frame of a suite with the true places of its stars and those that were answered. Whether there is a picture: a build may draw none.
pub(super) fn answered_frame(path: &Path, frame: &boresight::suite::FailureFrame) -> Result<bool> {
    /// An answer nearer than this to a star is that star's.
    const SAME_PX: f64 = 3.0;
    let [width_px, height_px] = frame.size_px;
    let image = boresight::frame::Frame {
        width_px,
        height_px,
        pixels_dn: frame.pixels_dn.iter().map(|count| f32::from(*count)).collect(),
        saturation_dn: 65_535.0,
    };
    let near = |[x, y]: [f64; 2], others: &[[f64; 2]]| others.iter().any(|[u, v]| (u - x).hypot(v - y) <= SAME_PX);
    let mark = |[x_px, y_px]: [f64; 2], kind, label: Option<&str>| report::Mark { x_px, y_px, label: label.map(str::to_owned), kind };
    // A star with an answer, one without, and an answer without a star.
    let stars = frame.stars_px.iter().map(|place| {
        let kind = if near(*place, &frame.centroids_px) { report::MarkKind::Answered } else { report::MarkKind::Unanswered };
        mark(*place, kind, None)
    });
    let lonely = frame.centroids_px.iter().filter(|place| !near(**place, &frame.stars_px));
    let marks: Vec<report::Mark> = stars.chain(lonely.map(|place| mark(*place, report::MarkKind::Starless, None))).collect();
    report::frame_picture(path, &image, &marks, &[])?;
    Ok(path.exists())
}
