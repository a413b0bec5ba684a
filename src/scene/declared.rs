//! What the recording of a scene declares: the nominal camera and not the true one, and its frames.

use super::Scene;
use crate::camera::Camera;
use crate::recording::{CameraInfo, Form, FrameEntry, FrameSize, Mount, Recording, Shutter, Site};

/// The recording as its manifest declares it, without its frames: with the nominal camera, not the true one.
#[must_use]
pub fn declared_recording(scene: &Scene) -> Recording {
    let Camera { width_px, height_px, principal_point_px, focal_length_px, k1, p1, p2 } = scene.nominal;
    let detector = scene.detector.joined(scene.binning);
    let camera = CameraInfo {
        width_px,
        height_px,
        focal_length_px: Some(focal_length_px),
        principal_point_px: Some(principal_point_px),
        k1: Some(k1),
        p1: Some(p1),
        p2: Some(p2),
        gain_e_per_dn: Some(detector.gain_e_per_dn),
        bias_dn: Some(detector.bias_dn),
        read_noise_e: Some(detector.read_noise_e),
        saturation_dn: Some(detector.full_pixel_dn()),
        zero_point_e_per_s: Some(scene.detector.zero_point_e_per_s),
        shutter: scene.nominal_line_time_us.map(|_| Shutter::Rolling),
        line_time_us: scene.nominal_line_time_us,
        first_row: scene.first_row,
        passband: Some("V".into()),
        ..CameraInfo::default()
    };
    let site = scene.site.as_ref().map(Site::from);
    let mount = Some(if scene.is_fixed { Mount::Fixed } else { Mount::Free });
    Recording { mount, site, form: Form::Manifest, ..Recording::new(camera) }
}

/// What it says of an exposure; the file is not known here.
#[must_use]
pub fn declared_entry(scene: &Scene, number: usize) -> FrameEntry {
    let Camera { width_px, height_px, .. } = scene.nominal;
    let exposure = scene.exposures.get(number);
    FrameEntry {
        number,
        size: Some(FrameSize { width_px, height_px }),
        time_utc: exposure.time,
        exposure_s: Some(exposure.exposure_s),
        ..exposure.telemetry.entry()
    }
}
