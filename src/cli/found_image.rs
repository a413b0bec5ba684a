//! What `diagnose` found in pixels, as the tables of a scene: star image, detector, sky, stages.

use std::collections::BTreeMap;

use boresight::diagnose::{Channel, Diagnosis, Finding, FoundParameter};
use boresight::effects::pixel::{DetectorScale, found_parameter, found_stage};
use boresight::recording::CameraInfo;
use boresight::scene::{CosmicRayTable, DetectorTable, EffectTable, GhostTable, PsfTable, VaryTable};

/// A ghost that is found is sharp, or its width is not told; it is rendered so wide.
const GHOST_RADIUS_PX: f64 = 2.0;

/// The declared gain, read noise and bias, held against the noise of the sky.
const GAIN_NOISE: &str = "gain-noise";

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

/// The tables of all findings that images decide; `detector` gets the colour term.
pub(super) fn found_image(diagnosis: &Diagnosis, detector: &mut DetectorTable, size_px: [usize; 2]) -> FoundImage {
    let mut all = FoundImage::default();
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
            // It stands in the detector's numbers.
            GAIN_NOISE => {}
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
                Some((table, without)) => {
                    all.left_out.extend(
                        without.iter().map(|name| format!("{}: {name} was found, and the stage of the renderer has it not", finding.id)),
                    );
                    all.effects.push(table);
                }
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

/// Gain, read noise, bias and zero point as they are declared, and as the noise of the sky tells them where nothing is or a gain was found wrong. What
/// is converted to electrons needs the gain first.
pub(super) struct DetectorNumbers {
    gain_e_per_dn: Option<f64>,
    bias_dn: Option<f64>,
    pub(super) read_noise_e: Option<f64>,
    pub(super) zero_point_e_per_s: Option<f64>,
}

impl DetectorNumbers {
    pub(super) fn of(diagnosis: &Diagnosis, camera: &CameraInfo) -> Self {
        let status = diagnosis.effects.iter().find(|own| own.id == GAIN_NOISE);
        let measured = |name: &str| status?.parameters.iter().find(|own| own.name == name).map(|own| own.value);
        let finding = diagnosis.findings.iter().find(|own| own.id == GAIN_NOISE);
        let ratio = finding.and_then(|own| own.parameters.iter().find(|own| own.name == "gain_ratio")).map(|own| own.value);
        Self {
            gain_e_per_dn: camera.gain_e_per_dn.map(|gain| gain * ratio.unwrap_or(1.0)).or_else(|| measured("gain_e_per_dn")),
            bias_dn: camera.bias_dn.or_else(|| measured("bias_dn")),
            // Beside another gain, or more variance than declared, they are told by the frames.
            read_noise_e: camera.read_noise_e.filter(|_| finding.is_none()).or_else(|| measured("read_noise_e")),
            zero_point_e_per_s: camera.zero_point_e_per_s.filter(|_| ratio.is_none()),
        }
    }

    pub(super) fn gain_e_per_dn(&self) -> f64 {
        self.gain_e_per_dn.unwrap_or(1.0)
    }

    pub(super) fn bias_dn(&self) -> f64 {
        self.bias_dn.unwrap_or(0.0)
    }

    /// What nobody declares and nothing tells, one sentence each.
    pub(super) fn assumed(&self) -> Vec<String> {
        let gain =
            self.gain_e_per_dn.is_none().then(|| "no gain is declared or told by the sky: 1 electron per count is assumed".to_owned());
        let bias = self
            .bias_dn
            .is_none()
            .then(|| "no bias is declared or told by the sky: 0 counts are assumed, and the sky has the rest".to_owned());
        gain.into_iter().chain(bias).collect()
    }
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
            "sigma_px_per_kelvin_at_corner" => &[(1.0, [2, 0, 0, 1]), (1.0, [0, 2, 0, 1])],
            "sigma_px_per_kelvin_x" => &[(1.0, [1, 0, 0, 1])],
            "sigma_px_per_kelvin_y" => &[(1.0, [0, 1, 0, 1])],
            _ => &[],
        };
        powers.iter().map(|(factor, powers)| term(factor * value, *powers)).collect()
    };
    finding.parameters.iter().flat_map(|own| of(&own.name, own.value)).collect()
}

/// A stage of the renderer with the parameters that were found, and the names of those that it lacks; nothing where it has none of them.
fn stage<'a>(finding: &'a Finding, detector: &DetectorTable, [width, height]: [usize; 2]) -> Option<(EffectTable, Vec<&'a str>)> {
    let scale = DetectorScale { gain_e_per_dn: detector.gain_e_per_dn, full_well_e: detector.full_well_e, pixels: (width * height) as f64 };
    let id = found_stage(&finding.id);
    let mut parameters = BTreeMap::new();
    let mut without = Vec::new();
    for FoundParameter { name, value, .. } in &finding.parameters {
        match found_parameter(id, name, &scale) {
            Some((own, factor)) => {
                parameters.insert(own.to_owned(), value * factor);
            }
            None if *value != 0.0 => without.push(name.as_str()),
            None => {}
        }
    }
    (!parameters.is_empty()).then(|| (EffectTable { id: id.to_owned(), parameters }, without))
}
