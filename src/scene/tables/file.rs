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
