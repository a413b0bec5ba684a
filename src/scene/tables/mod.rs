//! What stands in a scene file: its tables with their keys and defaults, and nothing of what is made of them.

mod camera;
mod detector;
mod effects;
mod exposures;
mod file;
mod lights;
mod psf;
mod sky;

pub use camera::{BinningMethod, BinningSite, BinningTable, MountTable, NominalTable, TrueCameraTable};
pub use detector::{ColourFiltersTable, DetectorTable, QuantumEfficiencyTable};
pub use effects::EffectTable;
pub use exposures::{BandTable, FrameTable, JitterTable, LineTable, OrbitTable, SeriesTable};
pub use file::SceneFile;
pub use lights::{CosmicRayTable, GhostTable, StreakKind, StreakTable};
pub use psf::{PixelTable, PsfTable, VaryTable};
pub use sky::{SiteTable, SkyTable};
