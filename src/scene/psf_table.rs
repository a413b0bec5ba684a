//! What `[psf]` means, and its checks.

use std::path::Path;

use super::psf::{Psf, PsfKind, PsfNodes, PsfTerm, Third};
use super::{PsfTable, SceneError};
use crate::effects::ParameterSpec;
use crate::effects::optics::elliptic_gaussian_psf::EllipticGaussianPsf;
use crate::effects::optics::sampled_psf::SampledImage;
use crate::effects::optics::tables::{IMAGE_KINDS, PixelResponse, image_kind};
use crate::effects::pixel::Psf2d;
use crate::recording::Recording;

/// Tables are one buffer of a GPU; every implementation grants this much.
pub(super) const MAX_BYTES: u64 = 128 << 20;

type Refuse<'a> = &'a dyn Fn(&str, String, &'static str) -> SceneError;
type Wrong<'a> = &'a dyn Fn(String) -> SceneError;

/// Reads `[psf]`, or makes the Gaussian of `detector.psf_sigma_px`.
pub(super) fn read(
    path: &str,
    table: Option<&PsfTable>,
    sigma_px: f64,
    size_px: [usize; 2],
    temperatures_k: [f64; 2],
) -> Result<Psf, SceneError> {
    let Some(table) = table else { return Ok(Psf::gaussian(sigma_px, size_px)) };
    let refuse = |key: &str, value: String, remedy: &'static str| SceneError::Value {
        path: path.to_owned(),
        key: format!("psf.{key}"),
        value,
        remedy,
    };
    let wrong = |what: String| SceneError::Parse { path: path.to_owned(), message: format!("psf: {what}") };
    let pixel = response(table, &refuse)?;
    let kind = kind(path, table, &pixel, &refuse, &wrong)?;
    let specs: &'static [ParameterSpec] = match &kind {
        PsfKind::Gaussian => image_kind("gaussian").map_or(&[], |kind| kind.parameters()),
        PsfKind::Elliptic => EllipticGaussianPsf.parameters(),
        PsfKind::Tables(kind) => kind.parameters(),
        PsfKind::Sampled(_) => &[],
    };
    for name in table.parameters.keys() {
        place(table, specs, name, &wrong)?;
    }
    let parameters = parameters(table, specs, &wrong)?;
    let terms = terms(table, specs, &wrong)?;
    let nodes = nodes(table, &kind, &terms, temperatures_k, &refuse, &wrong)?;
    let mut psf = Psf {
        kind,
        pixel,
        smooth_px: 0.0,
        typical_px: 0.0,
        reach_px: 0,
        nodes,
        own_per_px: 1,
        specs,
        parameters,
        terms,
        size_px,
        temperatures_k,
    };
    psf.measure(table.reach_px).map_err(|(key, value, remedy)| refuse(key, value, remedy))?;
    Ok(psf)
}

/// The response within a pixel.
fn response(table: &PsfTable, refuse: Refuse<'_>) -> Result<PixelResponse, SceneError> {
    let pixel = table.pixel.clone().unwrap_or_default();
    let is_sampled = table.kind == "sampled";
    if !is_sampled && (table.image.is_some() || table.image_points_per_px.is_some() || table.image_has_pixel) {
        return Err(refuse("image", "given".into(), "belongs to kind = \"sampled\""));
    }
    let numbers = pixel.cosine.iter().chain(&pixel.slope);
    if !numbers.clone().all(|number| number.abs() <= 1.0) || !(0.0..=5.0).contains(&pixel.diffusion_px) {
        return Err(refuse("pixel", format!("{pixel:?}"), "must have cosine and slope between -1 and 1 and diffusion_px between 0 and 5"));
    }
    Ok(PixelResponse { cosine: pixel.cosine, slope: pixel.slope, diffusion_px: pixel.diffusion_px, is_in_image: table.image_has_pixel })
}

/// What makes the images.
fn kind(path: &str, table: &PsfTable, pixel: &PixelResponse, refuse: Refuse<'_>, wrong: Wrong<'_>) -> Result<PsfKind, SceneError> {
    let is_even = *pixel == PixelResponse { is_in_image: table.image_has_pixel, ..PixelResponse::default() };
    Ok(match table.kind.as_str() {
        "gaussian" if is_even => PsfKind::Gaussian,
        "elliptic-gaussian" if is_even => PsfKind::Elliptic,
        "elliptic-gaussian" => {
            return Err(refuse("pixel", "given".into(), "is not worked out for elliptic-gaussian: use gaussian, zernike or sampled"));
        }
        "sampled" => PsfKind::Sampled(image(path, table, refuse, wrong)?),
        other => {
            let known = ["elliptic-gaussian", "sampled"].into_iter().chain(IMAGE_KINDS.iter().map(|kind| kind.id()));
            let nearest = known.min_by_key(|known| strsim::damerau_levenshtein(other, known)).unwrap_or_default();
            let unknown = || wrong(format!("there is no kind {other:?}; did you mean {nearest}?"));
            PsfKind::Tables(image_kind(other).ok_or_else(unknown)?)
        }
    })
}

/// The index of a parameter of the kind.
fn place(table: &PsfTable, specs: &[ParameterSpec], name: &str, wrong: Wrong<'_>) -> Result<usize, SceneError> {
    specs.iter().position(|spec| spec.name == name).ok_or_else(|| {
        let names: Vec<&str> = specs.iter().map(|spec| spec.name).collect();
        wrong(format!("{} has no parameter {name}; it has {}", table.kind, names.join(", ")))
    })
}

/// The parameters in the order of the kind.
fn parameters(table: &PsfTable, specs: &[ParameterSpec], wrong: Wrong<'_>) -> Result<Vec<f64>, SceneError> {
    let mut parameters = Vec::with_capacity(specs.len());
    for spec in specs {
        let is_optional = spec.unit.is_empty() && spec.name != "beta" || spec.name == "angle_deg";
        let value = match table.parameters.get(spec.name) {
            Some(value) => *value,
            None if is_optional => 0.0,
            None => return Err(wrong(format!("{} needs the parameter {}", table.kind, spec.name))),
        };
        if !(spec.range.0..=spec.range.1).contains(&value) {
            return Err(wrong(format!("{} = {value} must lie between {} and {}", spec.name, spec.range.0, spec.range.1)));
        }
        parameters.push(value);
    }
    Ok(parameters)
}

/// How the parameters change over the field, with colour and with temperature.
fn terms(table: &PsfTable, specs: &[ParameterSpec], wrong: Wrong<'_>) -> Result<Vec<PsfTerm>, SceneError> {
    let mut terms = Vec::new();
    for vary in &table.vary {
        let powers = [vary.x, vary.y, vary.colour, vary.temperature];
        let sum: u32 = powers.iter().map(|power| u32::from(*power)).sum();
        if !vary.coefficient.is_finite() || !(1..=8).contains(&sum) {
            let name = &vary.parameter;
            return Err(wrong(format!(
                "the term of {name} must have a finite coefficient and powers of x, y, colour, temperature, 1 to 8 together"
            )));
        }
        let index = place(table, specs, &vary.parameter, wrong)?;
        terms.push(PsfTerm { index, coefficient: vary.coefficient, powers: powers.map(i32::from) });
    }
    Ok(terms)
}

/// Where tables are worked out.
fn nodes(
    table: &PsfTable,
    kind: &PsfKind,
    terms: &[PsfTerm],
    temperatures_k: [f64; 2],
    refuse: Refuse<'_>,
    wrong: Wrong<'_>,
) -> Result<PsfNodes, SceneError> {
    let from_tables = matches!(kind, PsfKind::Tables(_));
    let follows = |axis: usize| from_tables && terms.iter().any(|term| term.powers[axis] > 0);
    if !table.field_nodes.iter().chain([&table.depth_nodes]).all(|nodes| (2..=65).contains(nodes)) {
        return Err(refuse("field_nodes", format!("{:?}", table.field_nodes), "and depth_nodes must lie between 2 and 65"));
    }
    let (third, range) = match (follows(2), follows(3)) {
        (false, false) => (Third::Nothing, PsfNodes::ONE.range),
        (true, false) => (Third::Colour, PsfNodes::COLOURS),
        // Exposures of one temperature need no second table, but the axis needs a length.
        (false, true) => (Third::Temperature, [temperatures_k[0], temperatures_k[1].max(temperatures_k[0] + 1e-6)]),
        (true, true) => return Err(wrong(format!("{} can follow colour or temperature, not both", table.kind))),
    };
    let [columns, rows] = if follows(0) || follows(1) { table.field_nodes } else { [1, 1] };
    let depth = if third == Third::Nothing { 1 } else { table.depth_nodes };
    Ok(PsfNodes { columns, rows, third, depth, range })
}

/// Reads the image of `kind = "sampled"`.
fn image(path: &str, table: &PsfTable, refuse: Refuse<'_>, wrong: Wrong<'_>) -> Result<SampledImage, SceneError> {
    let Some(name) = &table.image else {
        return Err(refuse("image", "none".into(), "must name the file of the image, relative to the scene"));
    };
    let points_per_px = table.image_points_per_px.unwrap_or_default();
    if !(1..=64).contains(&points_per_px) {
        return Err(refuse("image_points_per_px", points_per_px.to_string(), "must lie between 1 and 64"));
    }
    let file = Path::new(path).parent().unwrap_or(Path::new("")).join(name);
    let frame = Recording::open(&[&file]).and_then(|recording| recording.load_masked(0)).map_err(|error| wrong(error.to_string()))?;
    if frame.undefined.is_some() {
        return Err(refuse("image", format!("{} points without a value", frame.count_undefined()), "must have a number at every point"));
    }
    let frame = frame.frame;
    let image = SampledImage { width: frame.width_px, height: frame.height_px, values: frame.pixels_dn, points_per_px };
    if image.width.max(image.height) > 2048 {
        return Err(refuse("image", format!("{} × {} points", image.width, image.height), "must not be larger than 2048 × 2048"));
    }
    if image.sum() <= 0.0 {
        return Err(refuse("image", format!("sum {}", image.sum()), "holds no light"));
    }
    Ok(image)
}
