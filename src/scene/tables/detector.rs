//! `[detector]`.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// `[detector]`: PSF and detector.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct DetectorTable {
    /// Gaussian σ of the PSF; a `[psf]` of its own goes before it.
    pub psf_sigma_px: f64,
    /// Electrons per second of a star of V = 0.
    pub zero_point_e_per_s: f64,
    /// Electrons per count.
    pub gain_e_per_dn: f64,
    /// Count of an empty pixel.
    pub bias_dn: f64,
    /// Read noise (standard deviation).
    pub read_noise_e: f64,
    /// A dark frame of the camera (FITS, TIFF, PNG, …) in the place of read noise and dark current: its counts less `bias_dn`, times `gain_e_per_dn`, are
    /// what reading a pixel adds. It holds as many pixels as the frame or more. A path that is not absolute begins at the folder of the scene.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub dark_frame: Option<String>,
    /// Column and row of the dark frame at which the frame begins.
    #[serde(skip_serializing_if = "is_corner")]
    pub dark_frame_corner_px: [usize; 2],
    /// Bits of the converter, 8 to 16.
    pub bits: u32,
    /// Highest count of the converter; the end of its bits, 2^bits − 1, if absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub saturation_dn: Option<f64>,
    /// Electrons that a pixel holds.
    pub full_well_e: f64,
    /// How many magnitudes fainter than V says the camera sees a star, for each magnitude of B − V above 0.6; negative where it is more
    /// sensitive in the red than in V.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub colour_term_mag_per_mag: Option<f64>,
    /// The camera's response over the wavelengths, from which the colour's part follows; in the place of `colour_term_mag_per_mag`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub quantum_efficiency: Option<QuantumEfficiencyTable>,
    /// How the filters of a mosaic share the light of stars of different colours.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub colour_filters: Option<ColourFiltersTable>,
}

impl Default for DetectorTable {
    fn default() -> Self {
        Self {
            psf_sigma_px: 1.2,
            zero_point_e_per_s: 5.0e6,
            gain_e_per_dn: 2.0,
            bias_dn: 200.0,
            read_noise_e: 5.0,
            dark_frame: None,
            dark_frame_corner_px: [0; 2],
            bits: 16,
            saturation_dn: None,
            full_well_e: 1.0e5,
            colour_term_mag_per_mag: None,
            quantum_efficiency: None,
            colour_filters: None,
        }
    }
}

fn is_corner(place: &[usize; 2]) -> bool {
    *place == [0; 2]
}

/// `[detector.quantum_efficiency]`: a curve through the points given, straight between them and nothing beyond; only its shape counts.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct QuantumEfficiencyTable {
    /// Wavelengths, increasing.
    pub wavelengths_nm: Vec<f64>,
    /// Electrons per photon.
    pub values: Vec<f64>,
    /// Transmission of the optics at the same wavelengths; 1 if absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub transmission: Option<Vec<f64>>,
}

/// `[detector.colour_filters]`: red filters at even columns of even rows, blue ones at odd columns of odd rows, green ones elsewhere. Either curves or
/// `relative_per_mag`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ColourFiltersTable {
    /// Wavelengths, increasing.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub wavelengths_nm: Vec<f64>,
    /// Transmission of the red filters there.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub red: Vec<f64>,
    /// Transmission of the green ones.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub green: Vec<f64>,
    /// Transmission of the blue ones.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub blue: Vec<f64>,
    /// Instead: by how much more than green ones red pixels count, and blue ones less, for each magnitude of B − V above 0.6.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub relative_per_mag: Option<f64>,
}
