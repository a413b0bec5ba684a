//! Masks: why a pixel's count is not that of the sky and the stars alone.

use crate::effects::ids;
use crate::imaging::{FrameExposure, Imager, ImagingError, NoiseFree, PlaneLight, Stamp};
use crate::scene::LightKind;
use schemars::JsonSchema;
use serde::Serialize;

/// A flag of a pixel; a mask holds the sum of its flags' values.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, JsonSchema)]
pub struct MaskFlag {
    /// What the flag says, as a word.
    pub name: &'static str,
    /// Its value, a power of two.
    pub value: u16,
    /// What it says, as a sentence.
    pub meaning: &'static str,
}

impl MaskFlag {
    /// A defect adds charge in this frame.
    pub const HOT: u16 = 1;
    /// The pixel gives nothing.
    pub const DEAD: u16 = 2;
    /// A telegraph pixel in its high state.
    pub const TELEGRAPH: u16 = 4;
    /// A satellite's or a meteor's trail.
    pub const TRAIL: u16 = 8;
    /// A ghost.
    pub const GHOST: u16 = 16;
    /// A particle's track.
    pub const COSMIC_RAY: u16 = 32;
    /// Full.
    pub const SATURATED: u16 = 64;
    /// Charge over the full well went from it or came to it.
    pub const BLOOMED: u16 = 128;

    /// All flags, in the order of their values.
    pub const ALL: [Self; 8] = [
        Self::new("hot", Self::HOT, "a defect adds charge in this frame"),
        Self::new("dead", Self::DEAD, "the pixel gives nothing"),
        Self::new("telegraph", Self::TELEGRAPH, "a telegraph pixel is in its high state"),
        Self::new("trail", Self::TRAIL, "a satellite or a meteor leaves half an electron or more"),
        Self::new("ghost", Self::GHOST, "ghosts of stars leave half an electron or more, each"),
        Self::new("cosmic-ray", Self::COSMIC_RAY, "a particle leaves half an electron or more"),
        Self::new("saturated", Self::SATURATED, "the count is that of a full pixel"),
        Self::new("bloomed", Self::BLOOMED, "charge over the full well went from the pixel or came to it"),
    ];

    const fn new(name: &'static str, value: u16, meaning: &'static str) -> Self {
        Self { name, value, meaning }
    }
}

/// Less light of a trail, a ghost or a particle is left unmarked, and so is less charge that moved.
const MIN_E: f64 = 0.5;

/// Sets a flag where the value of a pixel says so.
fn mark<T>(mask: &mut [u16], flag: u16, values: &[T], is_marked: impl Fn(&T) -> bool) {
    for (flags, value) in mask.iter_mut().zip(values) {
        *flags |= if is_marked(value) { flag } else { 0 };
    }
}

/// The mask of a frame, row by row. `others`: what lights it and is no star.
pub(super) fn mask(
    imager: &Imager,
    chain: &NoiseFree<'_>,
    exposure: &FrameExposure<'_>,
    planes: &[PlaneLight<'_>],
    pixels_dn: &[u16],
    others: &[(LightKind, Option<Stamp>)],
    width_px: usize,
) -> Result<Vec<u16>, ImagingError> {
    let mut mask = vec![0; pixels_dn.len()];
    imager.on_single_electrons(ids::HOT_PIXELS, exposure, |first, electrons| {
        mark(&mut mask[first..], MaskFlag::HOT, electrons, |electrons| *electrons > 1.0);
        mark(&mut mask[first..], MaskFlag::DEAD, electrons, |electrons| *electrons == 0.0);
    })?;
    imager.on_single_electrons(ids::RANDOM_TELEGRAPH, exposure, |first, electrons| {
        mark(&mut mask[first..], MaskFlag::TELEGRAPH, electrons, |electrons| *electrons > 1.0);
    })?;
    if let Some(full_dn) = imager.saturation_dn() {
        mark(&mut mask, MaskFlag::SATURATED, pixels_dn, |count| f32::from(*count) >= full_dn);
    }
    if let Some([before, after]) = imager.before_and_after(ids::BLOOMING, exposure, planes)? {
        let moved: Vec<f32> = before.iter().zip(&after).map(|(before, after)| (after - before).abs()).collect();
        mark(&mut mask, MaskFlag::BLOOMED, &moved, |electrons| f64::from(*electrons) >= MIN_E);
    }
    for (kind, stamp) in others {
        let Some(stamp) = stamp else { continue };
        let flag = match kind {
            LightKind::Ghost => MaskFlag::GHOST,
            LightKind::Satellite | LightKind::Meteor => MaskFlag::TRAIL,
            LightKind::CosmicRay => MaskFlag::COSMIC_RAY,
        };
        for (place, electrons) in chain.seen(stamp).electrons.into_iter().enumerate() {
            if electrons >= MIN_E {
                let (row, column) = (place / stamp.width_px, place % stamp.width_px);
                mask[(stamp.top_px + row) * width_px + stamp.left_px + column] |= flag;
            }
        }
    }
    Ok(mask)
}

/// The mask of joined pixels: all that is said of the own pixels of each, `factor` × `factor`, and whether it is full itself.
pub(super) fn joined_mask(own: &[u16], own_width_px: usize, factor: usize, pixels_dn: &[u16], full_dn: f64) -> Vec<u16> {
    let mut mask: Vec<u16> = pixels_dn.iter().map(|count| if f64::from(*count) >= full_dn { MaskFlag::SATURATED } else { 0 }).collect();
    let width_px = own_width_px / factor;
    for (place, flags) in own.iter().enumerate() {
        mask[place / own_width_px / factor * width_px + place % own_width_px / factor] |= flags;
    }
    mask
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_joined_pixel_has_the_flags_of_its_own() {
        let own = [MaskFlag::HOT, 0, 0, 0, MaskFlag::TRAIL, 0, 0, MaskFlag::DEAD];
        assert_eq!(joined_mask(&own, 4, 2, &[7, 900], 900.0), [MaskFlag::HOT | MaskFlag::TRAIL, MaskFlag::DEAD | MaskFlag::SATURATED]);
    }
}
