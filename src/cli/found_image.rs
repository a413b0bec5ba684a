//! What `diagnose` found in pixels, as the tables of a scene: star image, detector, sky, stages.

use std::collections::BTreeMap;

use boresight::diagnose::{Channel, Diagnosis, Finding, FoundParameter};
use boresight::effects::pixel::{DetectorScale, found_parameter, found_stage};
use boresight::recording::CameraInfo;
use boresight::scene::{CosmicRayTable, DetectorTable, EffectTable, GhostTable, PsfTable, VaryTable};

/// A ghost that is found is sharp, or its width is not told; it is rendered so wide.
const GHOST_RADIUS_PX: f64 = 2.0;

/// What the pixels have shown, as tables.
#[derive(Default)]
pub(super) struct FoundImage {
    pub(super) effects: Vec<EffectTable>,
    pub(super) psf: Option<PsfTable>,
    pub(super) ghosts: Vec<GhostTable>,
    pub(super) cosmic_rays: Option<CosmicRayTable>,
    pub(super) extinction_mag_per_airmass: Option<f64>,
    /// Sentences on what no table holds.
    pub(super) left_out: Vec<String>,
}

/// The tables of all findings that images decide; `detector` gets its own numbers.
pub(super) fn found_image(diagnosis: &Diagnosis, camera: &CameraInfo, detector: &mut DetectorTable, size_px: [usize; 2]) -> FoundImage {
    let mut all = FoundImage::default();
    measured_detector(diagnosis, camera, detector, &mut all.left_out);
    let mut vary = Vec::new();
    for finding in diagnosis.findings.iter().filter(|finding| is_of_images(finding)) {
        let value = |name: &str| finding.parameters.iter().find(|own| own.name == name).map(|own| own.value);
        match finding.id.as_str() {
            "passband" => detector.colour_term_mag_per_mag = value("mag_per_mag"),
            "extinction" => all.extinction_mag_per_airmass = value("mag_per_airmass"),
            "psf-shape" | "axial-colour" | "focus-drift" => {
                let terms = widths(finding, size_px);
                if terms.len() < finding.parameters.iter().filter(|own| own.value != 0.0).count() {
                    all.left_out.push(format!("{}: what follows no power of place, colour or temperature is left out", finding.id));
                }
                vary.extend(terms);
            }
            "gain-noise" => detector.gain_e_per_dn *= value("gain_ratio").unwrap_or(1.0),
            "ghost" => {
                let table = |share: f64| {
                    with_defaults::<GhostTable>(&format!("scale = -1.0\nfraction = {share:?}\nradius_px = {GHOST_RADIUS_PX:?}"))
                };
                all.ghosts.extend(value("relative").and_then(table));
            }
            "cosmic-rays" => {
                all.cosmic_rays = value("per_s").and_then(|rate| with_defaults(&format!("expected_per_s = {rate:?}")));
            }
            _ => match stage(finding, detector, size_px) {
                Some(table) => all.effects.push(table),
                None => all.left_out.push(format!("{} was found, and no stage of the renderer holds it", finding.id)),
            },
        }
    }
    if !vary.is_empty() {
        let parameters = BTreeMap::from([("sigma_px".to_owned(), detector.psf_sigma_px)]);
        all.psf = with_defaults::<PsfTable>("kind = \"gaussian\"").map(|plain| PsfTable { parameters, vary, ..plain });
    }
    all
}

/// A table with what a scene file that leaves out the rest has.
fn with_defaults<T: serde::de::DeserializeOwned>(text: &str) -> Option<T> {
    toml::from_str(text).ok()
}

/// Whether a channel beside places shows a finding; what places alone show stands in the camera.
fn is_of_images(finding: &Finding) -> bool {
    finding.channels.iter().any(|(channel, own)| *channel != Channel::Astrometry && own.is_some())
}

/// Gain, read noise and bias that nobody declares, as the sky tells them; what it does not tell is said.
fn measured_detector(diagnosis: &Diagnosis, camera: &CameraInfo, detector: &mut DetectorTable, left_out: &mut Vec<String>) {
    let measured = diagnosis.effects.iter().find(|own| own.id == "gain-noise");
    let of = |name: &str| measured.and_then(|own| own.parameters.iter().find(|own| own.name == name)).map(|own| own.value);
    let mut take = |declared: bool, name: &str, number: &mut f64, what: &str| match (declared, of(name)) {
        (true, _) => {}
        (false, Some(value)) => *number = value,
        (false, None) => left_out.push(format!("the {what} is not declared and cannot be told: {number:.3} is assumed")),
    };
    take(camera.gain_e_per_dn.is_some(), "gain_e_per_dn", &mut detector.gain_e_per_dn, "gain (electrons per count)");
    take(camera.bias_dn.is_some(), "bias_dn", &mut detector.bias_dn, "bias (counts)");
    take(camera.read_noise_e.is_some(), "read_noise_e", &mut detector.read_noise_e, "read noise (electrons)");
}

/// How the width of a Gaussian image changes. The powers of the diagnosis are of half-diagonals, those of a scene of half-widths.
fn widths(finding: &Finding, [width, height]: [usize; 2]) -> Vec<VaryTable> {
    let scale = width as f64 / (width as f64).hypot(height as f64);
    let term = |coefficient: f64, [x, y, colour, temperature]: [u8; 4]| VaryTable {
        parameter: "sigma_px".to_owned(),
        coefficient: coefficient * scale.powi(i32::from(x + y)),
        x,
        y,
        colour,
        temperature,
    };
    let of = |name: &str, value: f64| -> Vec<VaryTable> {
        let powers: &[(f64, [u8; 4])] = match name {
            "sigma_px_at_corner" => &[(1.0, [2, 0, 0, 0]), (1.0, [0, 2, 0, 0])],
            "sigma_px_per_half_diagonal_x" => &[(1.0, [1, 0, 0, 0])],
            "sigma_px_per_half_diagonal_y" => &[(1.0, [0, 1, 0, 0])],
            "sigma_px_at_corner_fourth_order" => &[(1.0, [4, 0, 0, 0]), (2.0, [2, 2, 0, 0]), (1.0, [0, 4, 0, 0])],
            "sigma_px_xx_less_yy" => &[(1.0, [2, 0, 0, 0]), (-1.0, [0, 2, 0, 0])],
            "sigma_px_xy" => &[(2.0, [1, 1, 0, 0])],
            "sigma_px_third_order_x" => &[(1.0, [3, 0, 0, 0]), (1.0, [1, 2, 0, 0])],
            "sigma_px_third_order_y" => &[(1.0, [2, 1, 0, 0]), (1.0, [0, 3, 0, 0])],
            "sigma_px_per_mag" => &[(1.0, [0, 0, 1, 0])],
            "sigma_px_per_mag2" => &[(1.0, [0, 0, 2, 0])],
            "sigma_px_per_kelvin" => &[(1.0, [0, 0, 0, 1])],
            "sigma_px_per_kelvin2" => &[(1.0, [0, 0, 0, 2])],
            _ => &[],
        };
        powers.iter().map(|(factor, powers)| term(factor * value, *powers)).collect()
    };
    finding.parameters.iter().flat_map(|own| of(&own.name, own.value)).collect()
}

/// A stage of the renderer with the parameters that were found; nothing where none of them is the stage's.
fn stage(finding: &Finding, detector: &DetectorTable, [width, height]: [usize; 2]) -> Option<EffectTable> {
    let scale = DetectorScale { gain_e_per_dn: detector.gain_e_per_dn, full_well_e: detector.full_well_e, pixels: (width * height) as f64 };
    let id = found_stage(&finding.id);
    let of = |own: &FoundParameter| {
        let (name, factor) = found_parameter(id, &own.name, &scale)?;
        Some((name.to_owned(), own.value * factor))
    };
    let parameters: BTreeMap<String, f64> = finding.parameters.iter().filter_map(of).collect();
    (!parameters.is_empty()).then(|| EffectTable { id: id.to_owned(), parameters })
}
