//! The scene file as a whole.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{
    CosmicRayTable, DetectorTable, EffectTable, FrameTable, GhostTable, JitterTable, MountTable, NominalTable, OrbitTable, PsfTable,
    SeriesTable, SiteTable, SkyTable, StreakTable, TrueCameraTable,
};

/// A scene as written.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SceneFile {
    /// Always `boresight-scene/1`.
    pub format: String,
    /// Seed of all random draws.
    #[serde(default)]
    pub seed: u64,
    /// Number of the first exposure among all that the camera takes: with the seed, the key of what chance does in it. Scenes with the same seed show
    /// the same camera (hot pixels, uneven response), those with other numbers other noise.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub first_frame: u32,
    /// The true camera.
    pub camera: TrueCameraTable,
    /// What the recording declares instead of the truth.
    #[serde(default)]
    pub nominal: NominalTable,
    /// The true detector and PSF.
    #[serde(default)]
    pub detector: DetectorTable,
    /// The true sky.
    #[serde(default)]
    pub sky: SkyTable,
    /// The place on the ground.
    pub site: Option<SiteTable>,
    /// The orbit of a camera in space.
    pub orbit: Option<OrbitTable>,
    /// How the light of a star is spread; if absent, as a Gaussian of `detector.psf_sigma_px`.
    pub psf: Option<PsfTable>,
    /// How the camera stands.
    pub mount: Option<MountTable>,
    /// Ghosts of bright stars.
    #[serde(default)]
    pub ghosts: Vec<GhostTable>,
    /// Trails of satellites and meteors.
    #[serde(default)]
    pub streaks: Vec<StreakTable>,
    /// Particles that cross the detector.
    pub cosmic_rays: Option<CosmicRayTable>,
    /// How it trembles.
    pub jitter: Option<JitterTable>,
    /// Effects with parameters of their own.
    #[serde(default)]
    pub effects: Vec<EffectTable>,
    /// Exposures at regular times, pointed by chance.
    pub series: Option<SeriesTable>,
    /// Exposures one by one.
    #[serde(default)]
    pub frames: Vec<FrameTable>,
}

#[allow(clippy::trivially_copy_pass_by_ref, reason = "serde passes what it asks about by reference")]
fn is_zero(number: &u32) -> bool {
    *number == 0
}
