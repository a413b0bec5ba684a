//! Check that all frames are of one camera, before the camera is solved.
//!
//! Two cameras of one frame size differ by their focal length. Every identified frame determines its own (with k1, to a per cent or so in a wide
//! field), and the frames fall into groups with a gap between them. A gap alone may be due to a lens whose distortion one frame determines badly:
//! so no frame of the one group may fit through the camera that a frame of the other has found.

use nalgebra::{Matrix3, Vector3};

use super::{IdentifiedFrame, Measured, MeasuredFrame, PipelineError};
use crate::camera::Model;
use crate::catalog::Catalog;
use crate::coordinates::PixelPoint;
use crate::identify::Solution;
use crate::recording::{FrameSize, Recording};
use crate::statistics::order::ascending;

/// Files of a group that are named.
const MAX_NAMED: usize = 12;
/// The gap between the focal lengths of two cameras, in ln f.
const GAP: f64 = 0.015;
/// It is so many times wider than the next widest within a camera.
const WIDER: f64 = 4.0;
/// A frame fits through another frame's camera if its stars are not off by more than this many times its own rms, and this, px.
const FITS: f64 = 4.0;
const FITS_PX: f64 = 2.0;

/// Refuses frames of several sizes, which need no look at their pixels.
pub fn check_sizes(recording: &Recording) -> Result<(), PipelineError> {
    if recording.common_size().is_ok() {
        return Ok(());
    }
    let mut sizes: Vec<(FrameSize, Vec<String>)> = Vec::new();
    for (frame, entry) in recording.frames.iter().enumerate() {
        let Some(size) = entry.size else { continue };
        let name = recording.frame_name(frame);
        match sizes.iter_mut().find(|(known, _)| *known == size) {
            Some((_, names)) => names.push(name),
            None => sizes.push((size, vec![name])),
        }
    }
    let groups: Vec<String> = sizes.iter().map(|(size, names)| format!("{size}: {}", named(names))).collect();
    Err(PipelineError::SeveralCameras { groups: groups.join("; ") })
}

/// Refuses identified frames whose own focal lengths are those of several cameras.
pub fn check_focal_lengths(measured: &Measured, identified: &[IdentifiedFrame], catalog: &Catalog) -> Result<(), PipelineError> {
    let mut own: Vec<Own> = measured
        .frames
        .iter()
        .zip(identified)
        .filter_map(|(frame, identified)| Some(Own { frame, identified, solution: identified.solution()? }))
        .collect();
    // Focal lengths of different laws do not mean the same.
    let Some(law) = own.first().map(|own| own.solution.projection) else { return Ok(()) };
    if own.iter().any(|own| own.solution.projection != law) {
        return Ok(());
    }
    ascending(&mut own, Own::focal_px);
    let groups = groups(&own.iter().map(Own::focal_px).collect::<Vec<_>>());
    let groups: Vec<&[Own]> = groups.into_iter().map(|range| &own[range]).collect();
    let apart = groups.windows(2).all(|pair| pair[0].iter().all(|a| pair[1].iter().all(|b| !a.fits(b, catalog) && !b.fits(a, catalog))));
    if groups.len() < 2 || !apart {
        return Ok(());
    }
    let words = |group: &&[Own]| {
        let names: Vec<String> = measured
            .frames
            .iter()
            .filter(|frame| group.iter().any(|own| own.frame.index == frame.index))
            .map(|frame| frame.name.clone())
            .collect();
        format!("focal length {:.0} px: {}", group[group.len() / 2].focal_px(), named(&names))
    };
    Err(PipelineError::SeveralCameras { groups: groups.iter().map(words).collect::<Vec<_>>().join("; ") })
}

/// Where sorted focal lengths fall apart: a group ends at a gap that is wide, and much wider than any within the groups.
fn groups(focal_px: &[f64]) -> Vec<std::ops::Range<usize>> {
    let gaps: Vec<f64> = focal_px.windows(2).map(|pair| (pair[1] / pair[0]).ln()).collect();
    let within = gaps.iter().copied().filter(|gap| *gap < GAP).fold(0.0, f64::max);
    let mut groups = Vec::new();
    let mut begin = 0;
    for (index, gap) in gaps.iter().enumerate() {
        if *gap >= GAP && *gap > WIDER * within {
            groups.push(begin..index + 1);
            begin = index + 1;
        }
    }
    groups.push(begin..focal_px.len());
    groups
}

/// A frame with what it tells of its camera.
struct Own<'a> {
    frame: &'a MeasuredFrame,
    identified: &'a IdentifiedFrame,
    solution: &'a Solution,
}

impl Own<'_> {
    fn focal_px(&self) -> f64 {
        self.solution.camera.focal_length_px
    }

    /// Whether this frame's stars stand where another frame's camera images them, the attitude free.
    fn fits(&self, other: &Own, catalog: &Catalog) -> bool {
        let camera = other.solution.camera;
        let Ok(model) = Model::new(camera).with_projection(other.solution.projection.id(), &[]) else { return true };
        let context = model.reference_context();
        let pairs: Vec<(Vector3<f64>, Vector3<f64>)> = self
            .solution
            .matches
            .iter()
            .filter_map(|matched| {
                let star = &self.frame.detections.stars[matched.detection];
                let x_px = if self.solution.parity < 0 { camera.width_px as f64 - 1.0 - star.x_px } else { star.x_px };
                let seen = model.direction(PixelPoint { x_px, y_px: star.y_px }, &context)?;
                let arrives = self.identified.sky.apparent(&catalog.stars[matched.star], catalog.epoch_yr).xyz;
                Some((Vector3::from(seen.xyz), Vector3::from(arrives)))
            })
            .collect();
        let profile: Matrix3<f64> = pairs.iter().map(|(seen, arrives)| seen * arrives.transpose()).sum();
        let Some(rotation) = crate::calibrate::optimal_rotation(&profile) else { return true };
        let square: f64 = pairs.iter().map(|(seen, arrives)| (rotation * arrives - seen).norm_squared()).sum();
        let rms_px = (square / pairs.len().max(1) as f64).sqrt() * camera.focal_length_px;
        rms_px <= (FITS * self.solution.rms_px).max(FITS_PX)
    }
}

/// Names in a row; of many the first.
fn named(names: &[String]) -> String {
    let more = names.len().saturating_sub(MAX_NAMED);
    let named = names[..names.len() - more].join(", ");
    if more > 0 { format!("{named} and {more} more") } else { named }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn focal_lengths_fall_apart_at_gaps_alone() {
        assert_eq!(groups(&[1000.0, 1001.0, 1100.0, 1102.0]), [0..2, 2..4]);
        assert_eq!(groups(&[1000.0, 1001.0, 1003.0]), std::slice::from_ref(&(0..3)));
        assert_eq!(groups(&[1000.0, 1013.0, 1040.0]), std::slice::from_ref(&(0..3)), "frames that scatter so tell nothing");
        assert_eq!(groups(&[800.0, 1000.0]), [0..1, 1..2]);
        assert_eq!(groups(&[1000.0]), std::slice::from_ref(&(0..1)));
        assert_eq!(named(&["a".to_owned(), "b".to_owned()]), "a, b");
        assert!(named(&vec!["a".to_owned(); 15]).ends_with("a and 3 more"));
    }
}
