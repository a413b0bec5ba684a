//! # Ghosts
//!
//! ## What it does
//!
//! Light of a bright star that goes to and fro between two surfaces of the lens, or the detector and a filter, before it arrives: a disc,
//! with the shadow of a secondary mirror if there is one, on the other side of the axis or beside the star.
//!
//! ## Equation
//!
//! Of a star at x a ghost stands at c + s·(x − c), c the principal point, as a disc of radius R of even light, electrons = f · those of the
//! star; within h·R there is none. How light falls on the pixels at its edge is on the page of `disc-psf`.
//!
//! ## Parameters
//!
//! In a scene, `[[ghosts]]`, one for each pair of surfaces: `scale` (s), `fraction` (f), `radius_px` (R), `obstruction` (h).
//!
//! ## Signature
//!
//! Discs that no star sends; a background that is brighter, and slopes, under stars within them.
//!
//! ## Confused with
//!
//! Nebulae and the Moon's glow, which stay on the sky; stray light, which has no edge.
//!
//! ## Neglected
//!
//! Ghosts that change their shape over the field, cut at the pupil's edge; colour (a coating reflects some colours more); discs with less than a
//! thousandth of an electron in a pixel are left out.
//!
//! ## Source
//!
//! W. J. Smith, Modern Optical Engineering (2008), chapter 9.

use super::{LightForm, LightKind, OtherLight, Refuse};
use crate::coordinates::PixelPoint;
use crate::effects::ParameterSpec;
use crate::effects::optics::disc_psf::DiscPsf;
use crate::effects::pixel::Psf2d;
use crate::scene::{GhostTable, Scene, SceneError, StarTrack};

/// What the table has, for the list of effects.
pub(super) fn parameters() -> &'static [ParameterSpec] {
    DiscPsf.parameters()
}

/// The page's text.
pub(super) fn source() -> &'static str {
    page_source!("ghosts.rs")
}

impl Scene {
    pub(super) fn ghosts_of(&self, tracks: &[StarTrack]) -> Vec<OtherLight> {
        /// A disc with less light in a pixel is left out, electrons.
        const FAINTEST_E_PER_PX: f64 = 1e-3;
        let centre = self.camera.principal_point_px;
        let mut lights = Vec::new();
        for ghost in &self.ghosts {
            let (radius_px, hole_px) = (ghost.radius_px, ghost.obstruction * ghost.radius_px);
            let area = std::f64::consts::PI * (radius_px * radius_px - hole_px * hole_px);
            for track in tracks {
                let electrons = ghost.fraction * track.electrons * track.samples.iter().map(|sample| sample.weight).sum::<f64>();
                if electrons < FAINTEST_E_PER_PX * area {
                    continue;
                }
                let mean = track.mean();
                let place = PixelPoint {
                    x_px: centre[0] + ghost.scale * (mean.x_px - centre[0]),
                    y_px: centre[1] + ghost.scale * (mean.y_px - centre[1]),
                };
                let form = LightForm::Disc { radius_px, hole_px };
                lights.push(OtherLight { kind: LightKind::Ghost, hip: Some(track.hip), electrons, ends: [place; 2], form });
            }
        }
        lights
    }
}

/// Checks the tables.
pub(super) fn check(refuse: Refuse<'_>, ghosts: &[GhostTable]) -> Result<(), SceneError> {
    for (index, ghost) in ghosts.iter().enumerate() {
        let values = [ghost.scale, ghost.fraction, ghost.radius_px, ghost.obstruction];
        for (spec, value) in parameters().iter().zip(values) {
            if !(spec.range.0..=spec.range.1).contains(&value) {
                let remedy = "must have scale -10 … 10, fraction 0 … 0.5, radius_px 1 … 2000 and obstruction 0 … 0.95";
                return refuse(format!("ghosts[{index}].{}", spec.name), value.to_string(), remedy);
            }
        }
    }
    Ok(())
}
