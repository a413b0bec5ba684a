//! Light and charge that no star of the catalogue sends: ghosts of bright stars, trails of satellites and meteors, cosmic rays. Each has its file, whose
//! head is its page.

mod cosmic_rays;
mod ghosts;
mod streaks;

use rand::SeedableRng;
use rand_distr::{Distribution, Poisson};
use rand_pcg::Pcg64;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::track::StarTrack;
use super::{CosmicRayTable, GhostTable, Scene, SceneError, StreakTable};
use crate::coordinates::PixelPoint;
use crate::effects::ParameterSpec;
use crate::rng::StageKey;

/// A light that a table of its own switches on: its page and what the table has.
#[derive(Clone, Copy, Debug)]
pub struct LightPage {
    /// The name of the page.
    pub id: &'static str,
    /// Keys of the table.
    pub parameters: fn() -> &'static [ParameterSpec],
    /// The text of its source file, whose head is the page.
    pub source: fn() -> &'static str,
}

/// The pages of all such lights.
pub const LIGHT_PAGES: &[LightPage] = &[
    LightPage { id: "ghosts", parameters: ghosts::parameters, source: ghosts::source },
    LightPage { id: "streaks", parameters: || streaks::PARAMETERS, source: streaks::source },
    LightPage { id: "cosmic-rays", parameters: || cosmic_rays::PARAMETERS, source: cosmic_rays::source },
];

/// What a light of this kind is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum LightKind {
    /// The ghost of a star.
    Ghost,
    /// A satellite's trail.
    Satellite,
    /// A meteor's trail.
    Meteor,
    /// A particle's track.
    CosmicRay,
}

/// A light in an exposure that is no star.
#[derive(Clone, Debug, PartialEq)]
pub struct OtherLight {
    /// What it is.
    pub kind: LightKind,
    /// Of a ghost: the star's catalogue number.
    pub hip: Option<u32>,
    /// Electrons that it sends.
    pub electrons: f64,
    /// Where it begins and ends; a ghost's middle.
    pub ends: [PixelPoint; 2],
    /// How it is spread.
    pub form: LightForm,
}

/// How such a light is spread.
#[derive(Clone, Debug, PartialEq)]
pub enum LightForm {
    /// A ring of even light between two radii, px.
    Disc {
        /// Outer radius.
        radius_px: f64,
        /// Inner radius.
        hole_px: f64,
    },
    /// By the optics, like a star with this way.
    Trail(StarTrack),
    /// Charge of this width along the line.
    Track {
        /// Width σ, px.
        sigma_px: f64,
    },
}

impl Scene {
    /// Everything in frame number `index` that shines or leaves charge and is no star. `tracks`: the frame's stars.
    ///
    /// # Panics
    /// If `index` is not below the number of exposures.
    #[must_use]
    pub fn other_lights(&self, index: usize, tracks: &[StarTrack]) -> Vec<OtherLight> {
        let mut lights = self.ghosts_of(tracks);
        lights.extend(self.streaks_in(index));
        lights.extend(self.cosmic_rays_in(index));
        lights
    }

    /// Random numbers of a frame for one kind of light; each kind has its own.
    pub(super) fn chance(&self, index: usize, stage: u32, number: u32) -> Pcg64 {
        let words = StageKey { seed: self.seed, frame: self.frame_number(index), stage }.words(number, 0);
        Pcg64::seed_from_u64(u64::from(words[0]) << 32 | u64::from(words[1]))
    }
}

/// A number by chance with this mean.
fn draw_count(mean: f64, rng: &mut Pcg64) -> u64 {
    Poisson::new(mean).map_or(0, |poisson: Poisson<f64>| poisson.sample(rng) as u64)
}

/// Says which key is wrong, what it is, and what it must be.
type Refuse<'a> = &'a dyn Fn(String, String, &'static str) -> Result<(), SceneError>;

/// Checks the tables.
pub(super) fn check(
    path: &str,
    ghosts: &[GhostTable],
    streaks: &[StreakTable],
    cosmic_rays: Option<&CosmicRayTable>,
) -> Result<(), SceneError> {
    let refuse = |key: String, value: String, remedy: &'static str| Err(SceneError::Value { path: path.to_owned(), key, value, remedy });
    ghosts::check(&refuse, ghosts)?;
    streaks::check(&refuse, streaks)?;
    cosmic_rays.map_or(Ok(()), |rays| cosmic_rays::check(&refuse, rays))
}
