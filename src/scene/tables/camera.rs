//! `[camera]`, `[nominal]` and `[mount]`.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::recording::{FirstRow, Mount};

/// `[camera]`: the truth, in the units of the reference model.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TrueCameraTable {
    /// Columns.
    pub width_px: usize,
    /// Rows.
    pub height_px: usize,
    /// Focal length.
    pub focal_length_px: f64,
    /// Principal point; the middle of the frame if absent.
    pub principal_point_px: Option<[f64; 2]>,
    /// Radial distortion, px⁻².
    #[serde(default)]
    pub k1: f64,
    /// Decentring distortion, px⁻¹.
    #[serde(default)]
    pub p1: f64,
    /// Decentring distortion, px⁻¹.
    #[serde(default)]
    pub p2: f64,
    /// The detector's own pixels are joined into those that this scene describes.
    pub binning: Option<BinningTable>,
    /// How the lens maps angles to the focal plane: `pinhole` (if absent), `equidistant`, `equisolid`, `stereographic`, `kannala-brandt`.
    pub projection: Option<String>,
    /// What the projection has beyond focal length and principal point: k1 … k4 of `kannala-brandt`.
    #[serde(default)]
    pub projection_parameters: Vec<f64>,
    /// With a rolling shutter, the time from one row to the next; a global shutter if absent.
    pub line_time_us: Option<f64>,
    /// The row that a rolling shutter reads first: `top` (row 0, also if absent) or `bottom`.
    pub first_row: Option<FirstRow>,
}

/// `[camera.binning]`: the detector's own pixels are joined, `factor` × `factor` into each pixel of the frame that this scene describes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct BinningTable {
    /// Pixels along each side of a joined one, 2 to 4.
    pub factor: usize,
    /// Whether a joined pixel holds the sum or the mean.
    #[serde(default)]
    pub method: BinningMethod,
    /// Where they are joined.
    #[serde(default)]
    pub place: BinningSite,
}

/// What a joined pixel holds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum BinningMethod {
    /// All of what its pixels hold.
    #[default]
    Sum,
    /// Their mean.
    Mean,
}

/// Where pixels are joined.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum BinningSite {
    /// As charge, before read noise and converter.
    #[default]
    OnChip,
    /// As counts, behind the converter.
    Digital,
}

/// `[mount]`: how the camera stands.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MountTable {
    /// `free`: each exposure has its own attitude. `fixed`: the camera stands fast on the ground as in the first exposure, and the Earth turns.
    pub kind: Mount,
}

/// `[nominal]`: what the recording says of the camera. What is absent is said truly, but for the distortion and the principal point, of
/// which a maker says nothing: they are 0 and the middle of the frame.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct NominalTable {
    /// Focal length.
    pub focal_length_px: Option<f64>,
    /// Principal point.
    pub principal_point_px: Option<[f64; 2]>,
    /// Radial distortion, px⁻².
    pub k1: Option<f64>,
    /// Decentring distortion, px⁻¹.
    pub p1: Option<f64>,
    /// Decentring distortion, px⁻¹.
    pub p2: Option<f64>,
    /// Time from row to row of a rolling shutter.
    pub line_time_us: Option<f64>,
}
