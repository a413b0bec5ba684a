//! Presets: scenes of real cameras, with their numbers and sources in the comments at the head of each file.

mod result;

pub use result::{ListedPreset, PRESET_FORMAT, PresetList};

/// A ready-made scene.
#[derive(Clone, Copy, Debug)]
pub struct Preset {
    /// Its name.
    pub name: &'static str,
    /// The scene, as a file that can be changed.
    pub toml: &'static str,
}

impl Preset {
    /// What it is: the first line of its file.
    #[must_use]
    pub fn title(&self) -> &'static str {
        self.toml.lines().next().unwrap_or_default().trim_start_matches(['#', ' '])
    }
}

macro_rules! presets {
    ($($name:literal),+) => { &[$(Preset { name: $name, toml: include_str!(concat!($name, ".toml")) }),+] };
}

/// All of them.
pub static PRESETS: &[Preset] =
    presets!("cubesat-tracker", "high-end-tracker", "machine-vision-35mm", "raspberry-pi-hq", "meteor-camera", "all-sky-fisheye");

/// The preset with this name.
#[must_use]
pub fn preset(name: &str) -> Option<&'static Preset> {
    PRESETS.iter().find(|preset| preset.name == name)
}
