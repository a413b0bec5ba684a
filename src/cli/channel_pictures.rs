//! Pictures of the channels beside places: brightness, shape, background and noise.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::Result;
use boresight::diagnose::{Diagnosis, ImageProfile, ShapeCell};
use boresight::pixel_statistics::{LineMeans, PixelHistogram, PixelStatistics, SkyMesh, TransferPoint};
use boresight::report::{FieldMap, Plot, ProfilePlot, ProfilePoint, Series, SeriesStyle, Vector};
use boresight::statistics::order::sort_by;

use super::pictures::significant;

/// Points along each side of a map.
const SIDE: usize = 41;
/// Bins of a plot of the noise.
const BINS: usize = 40;

/// Writes a picture of everything that was measured: a channel that was not looked at has none. `size`: columns and rows of the frames.
pub(super) fn write(directory: &Path, diagnosis: &Diagnosis, pixels: Option<&PixelStatistics>, size: (usize, usize)) -> Result<()> {
    for profile in diagnosis.image_profiles.iter().filter(|profile| !profile.bins.is_empty()) {
        let quantity = if profile.unit == "mag" { "brightness" } else { "size" };
        image_profile(profile).write(&directory.join(format!("{quantity}-{}.png", profile.covariate)))?;
    }
    if !diagnosis.shape_map.is_empty() {
        shape(&diagnosis.shape_map, size).write(&directory.join("shape.png"), size)?;
    }
    let Some(pixels) = pixels else { return Ok(()) };
    if let Some(plot) = photon_transfer(pixels) {
        plot.write(&directory.join("photon-transfer.png"))?;
    }
    let means = &pixels.means;
    let plots = [
        ("rows.png", lines("row", &means.rows)),
        ("columns.png", lines("column", &means.columns)),
        ("fixed-pattern.png", fixed_pattern(&means.pixels)),
    ];
    for (name, plot) in plots {
        if let Some(plot) = plot {
            plot.write(&directory.join(name))?;
        }
    }
    if let Some(map) = background(&pixels.sky, size) {
        map.write(&directory.join("background.png"), size)?;
    }
    Ok(())
}

/// Brightness or size of the star images against a covariate.
fn image_profile(profile: &ImageProfile) -> ProfilePlot {
    let x_label = match profile.covariate.as_str() {
        "field-radius" => "distance from the middle of the frame / half its diagonal",
        "magnitude" => "V / mag",
        "colour" => "B − V from the usual / mag",
        "zenith" => "air mass",
        "temperature" => "temperature from the mean / K",
        "time" => "time from the mean / h",
        other => other,
    };
    let (title, y_label) = if profile.unit == "mag" {
        ("Brightness of the stars", "magnitude less the catalogue's / mag (fainter is up)".to_owned())
    } else {
        ("Size of the star images", format!("half the trace of the second moments, from the mean / {}", profile.unit))
    };
    ProfilePlot {
        title: format!("{title} against {}", x_label.split(" / ").next().unwrap_or(x_label)),
        summary: "zero points and other nuisance parameters taken off; no effect taken off".to_owned(),
        x_label: x_label.to_owned(),
        y_label,
        points: "mean of the bin ± its standard error".to_owned(),
        counted: "images".to_owned(),
        bins: profile
            .bins
            .iter()
            .map(|bin| ProfilePoint { at: bin.at, mean: bin.mean, sigma: bin.sigma, model: bin.model, stars: bin.stars })
            .collect(),
    }
}

/// Width and elongation of the star images over the frame.
fn shape(cells: &[ShapeCell], size: (usize, usize)) -> FieldMap {
    let half = 0.5 * (size.0 as f64).hypot(size.1 as f64);
    let middle = [0.5 * (size.0 as f64 - 1.0), 0.5 * (size.1 as f64 - 1.0)];
    let whisker = |cell: &ShapeCell| {
        let [one, other] = cell.ellipticity;
        // The direction of an elongation turns by half of what its components do.
        let (length, angle) = (one.hypot(other), 0.5 * other.atan2(one));
        let [x_px, y_px] = [0, 1].map(|axis| middle[axis] + half * cell.at[axis]);
        Vector { x_px, y_px, dx_px: length * angle.cos(), dy_px: length * angle.sin(), rejected: false }
    };
    let stars: usize = cells.iter().map(|cell| cell.stars).sum();
    let errors = |of: fn(&ShapeCell) -> f64| cells.iter().map(of).sum::<f64>() / cells.len() as f64;
    let known: Vec<([f64; 2], f64)> = cells.iter().map(|cell| (cell.at, cell.width_px)).collect();
    FieldMap {
        title: "Shape of the star images".to_owned(),
        summary: format!(
            "{stars} images in {} cells; standard error of a cell: {} px of width, {} of ellipticity",
            cells.len(),
            significant(errors(|cell| cell.width_sigma_px)),
            significant(errors(|cell| cell.ellipticity_sigma))
        ),
        values: interpolated(&known, size),
        side: SIDE,
        unit: "width σ / px".to_owned(),
        arrows: cells.iter().map(whisker).collect(),
        whiskers: Some("of ellipticity (xx − yy, 2xy) / (xx + yy)".to_owned()),
        note: "colours: width of the images; lines: direction and size of their elongation; medians".to_owned(),
        ..FieldMap::default()
    }
}

/// Values at places (from the middle of the frame, over half its diagonal) as a smooth surface over the frame.
fn interpolated(known: &[([f64; 2], f64)], size: (usize, usize)) -> Vec<f64> {
    let (width, height) = (size.0 as f64, size.1 as f64);
    let half = 0.5 * width.hypot(height);
    let reach = [0.5 * width / half, 0.5 * height / half];
    // As wide as the places are apart.
    let scale2 = 4.0 * reach[0] * reach[1] / known.len().max(1) as f64;
    let value = |k: usize| {
        let at = [k % SIDE, k / SIDE].map(|step| 2.0 * step as f64 / (SIDE as f64 - 1.0) - 1.0);
        let (mut sum, mut weights) = (0.0, 0.0);
        for (place, value) in known {
            let square: f64 = [0, 1].map(|axis| (at[axis] * reach[axis] - place[axis]).powi(2)).iter().sum();
            let weight = (-square / scale2).exp().max(1e-12);
            (sum, weights) = (sum + weight * value, weights + weight);
        }
        sum / weights
    };
    (0..SIDE * SIDE).map(value).collect()
}

/// Variance of the sky's pixels against their level, with the line that tells the gain.
fn photon_transfer(pixels: &PixelStatistics) -> Option<ProfilePlot> {
    // A line may be of the stars alone.
    let line = pixels.photon_transfer.as_ref().filter(|_| !pixels.transfer_points.is_empty())?;
    let mut points = pixels.transfer_points.clone();
    sort_by(&mut points, |a, b| a.level_dn.total_cmp(&b.level_dn));
    let of_bin = |bin: &[TransferPoint]| {
        let weights: Vec<f64> = bin.iter().map(|point| point.sigma_dn2.powi(-2)).collect();
        let sum: f64 = weights.iter().sum();
        let mean = |of: fn(&TransferPoint) -> f64| bin.iter().zip(&weights).map(|(point, weight)| weight * of(point)).sum::<f64>() / sum;
        let at = mean(|point| point.level_dn);
        ProfilePoint {
            at,
            mean: mean(|point| point.variance_dn2),
            sigma: sum.sqrt().recip(),
            model: line.intercept_dn2 + line.slope_dn * at,
            stars: bin.len(),
        }
    };
    let gain = match (line.gain_e_per_dn, line.gain_sigma) {
        (Some(gain), Some(sigma)) => format!("gain {gain:.4} ± {sigma:.4} e/DN"),
        _ => "it gives no gain".to_owned(),
    };
    Some(ProfilePlot {
        title: "Photon transfer: noise of the sky against its level".to_owned(),
        summary: format!("{gain}; {} points, χ² per degree of freedom of the line {}", line.points, significant(line.chi2_per_dof)),
        x_label: "level / DN".to_owned(),
        y_label: "variance of a pixel / DN²".to_owned(),
        points: "parts of frames without stars, mean ± standard error".to_owned(),
        counted: "parts".to_owned(),
        bins: points.chunks(points.len().div_ceil(BINS).max(1)).map(of_bin).collect(),
    })
}

/// Rows or columns: in one frame, and in the mean of all.
fn lines(what: &str, means: &LineMeans) -> Option<Plot> {
    let series = |label: String, values: &[f32]| {
        let points = values.iter().enumerate().map(|(at, value)| [at as f64, f64::from(*value)]).collect();
        Series { label, style: SeriesStyle::Points, points }
    };
    let is_told = means.mean_dn.iter().any(|value| value.is_finite());
    is_told.then(|| Plot {
        title: format!("What each {what} has more than those around it"),
        x_label: format!("{what} / px"),
        y_label: "from its surroundings / DN".to_owned(),
        series: vec![
            series("the first frame".to_owned(), &means.first_dn),
            series(format!("mean of {} frames", means.frames), &means.mean_dn),
        ],
    })
}

/// The sky over the frame, mean of the frames, each less its own level.
fn background(frames: &[SkyMesh], size: (usize, usize)) -> Option<FieldMap> {
    let mut cells: BTreeMap<[i64; 2], ([f64; 2], f64, f64)> = BTreeMap::new();
    for mesh in frames {
        for cell in mesh.cells.iter().flatten() {
            let place = cell.at.map(|along| (along * 24.0).round() as i64);
            let sum = cells.entry(place).or_insert((cell.at, 0.0, 0.0));
            (sum.1, sum.2) = (sum.1 + cell.level_dn - mesh.level_dn, sum.2 + 1.0);
        }
    }
    let known: Vec<([f64; 2], f64)> = cells.into_values().map(|(at, sum, count)| (at, sum / count)).collect();
    (!known.is_empty()).then(|| FieldMap {
        title: "Background between the stars".to_owned(),
        summary: format!("mean of {} frames, each less its own median; {} cells", frames.len(), known.len()),
        values: interpolated(&known, size),
        side: SIDE,
        unit: "DN".to_owned(),
        note: "what is smooth over the frame: light of the sky, vignetting of it, glow".to_owned(),
        ..FieldMap::default()
    })
}

/// How far single pixels are from those around them, against what noise alone makes.
fn fixed_pattern(histogram: &PixelHistogram) -> Option<Plot> {
    let all = histogram.pixels.iter().sum::<u64>() as f64;
    let at = |bin: usize| (bin as f64 + 0.5) * PixelHistogram::STEP - PixelHistogram::REACH;
    let height = |pixels: f64| pixels.max(0.5).log10();
    let seen = histogram.pixels.iter().enumerate().map(|(bin, pixels)| [at(bin), height(*pixels as f64)]).collect();
    let by_noise = |bin: usize| {
        let z = at(bin);
        let pixels = all * PixelHistogram::STEP * (-0.5 * z * z).exp() / std::f64::consts::TAU.sqrt();
        [z, height(pixels)]
    };
    let expected = (0..histogram.pixels.len()).map(by_noise).collect();
    (all > 0.0).then(|| Plot {
        title: format!("Fixed pattern: the mean of each pixel over {} frames", histogram.frames),
        x_label: "from the pixels around it / standard error by the frames' noise (the outermost bins hold what is beyond)".to_owned(),
        y_label: "log10 of the pixels in a bin".to_owned(),
        series: vec![
            Series { label: "seen".to_owned(), style: SeriesStyle::Points, points: seen },
            Series { label: "noise alone".to_owned(), style: SeriesStyle::Line, points: expected },
        ],
    })
}
