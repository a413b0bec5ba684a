//! `[psf]`.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// `[psf]`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PsfTable {
    /// `gaussian`, `elliptic-gaussian`, `moffat`, `airy`, `zernike` or `sampled`.
    pub kind: String,
    /// Its parameters by name, in the middle of the field and at B − V = 0.6.
    #[serde(default)]
    pub parameters: BTreeMap<String, f64>,
    /// How parameters change over the field, with colour and with temperature.
    #[serde(default)]
    pub vary: Vec<VaryTable>,
    /// Columns and rows of places at which tables are worked out where the image changes over the field; stars in between mix the nearest four.
    #[serde(default = "default_field_nodes")]
    pub field_nodes: [usize; 2],
    /// Colours (evenly from B − V = −0.4 to 2) or temperatures (over those of the exposures) at which tables are worked out where the image
    /// changes with one of the two.
    #[serde(default = "default_depth_nodes")]
    pub depth_nodes: usize,
    /// How far a star's light is followed.
    pub reach_px: Option<usize>,
    /// The response within a pixel.
    pub pixel: Option<PixelTable>,
    /// With `sampled`: the image, relative to the scene.
    pub image: Option<String>,
    /// Its points along the side of a pixel.
    pub image_points_per_px: Option<usize>,
    /// Whether the pixel is in it already.
    #[serde(default)]
    pub image_has_pixel: bool,
}

impl PsfTable {
    /// A round Gaussian, the same all over the field.
    #[must_use]
    pub fn gaussian(sigma_px: f64) -> Self {
        Self {
            kind: "gaussian".to_owned(),
            parameters: BTreeMap::from([("sigma_px".to_owned(), sigma_px)]),
            vary: Vec::new(),
            field_nodes: default_field_nodes(),
            depth_nodes: default_depth_nodes(),
            reach_px: None,
            pixel: None,
            image: None,
            image_points_per_px: None,
            image_has_pixel: false,
        }
    }
}

fn default_field_nodes() -> [usize; 2] {
    [5, 5]
}

fn default_depth_nodes() -> usize {
    3
}

/// A term of a parameter: coefficient · Xⁱ·Yʲ·Cᵏ·Tˡ, X and Y = offsets from the middle of the frame in halves of its width, C = B − V − 0.6, T =
/// temperature of the optics minus its mean over the exposures, K.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct VaryTable {
    /// Which parameter.
    pub parameter: String,
    /// In the parameter's unit.
    pub coefficient: f64,
    /// i.
    #[serde(default)]
    pub x: u8,
    /// j.
    #[serde(default)]
    pub y: u8,
    /// k.
    #[serde(default)]
    pub colour: u8,
    /// l.
    #[serde(default)]
    pub temperature: u8,
}

/// `[psf.pixel]`: the response along x and y, 1 + a·cos 2πu + b·u at u px from the pixel's centre, and diffusion of the charge.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct PixelTable {
    /// a along x and y.
    pub cosine: [f64; 2],
    /// b along x and y, px⁻¹.
    pub slope: [f64; 2],
    /// Width σ of the diffusion.
    pub diffusion_px: f64,
}
