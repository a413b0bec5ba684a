//! Identified frames → control points.

use super::background_slope::BackgroundSlope;
use super::{ControlPoint, ControlPoints, Identification, Projection, Solution};
use crate::camera::{Camera, SkyChain};
use crate::catalog::Catalog;
use crate::coordinates::Direction;
use crate::detect::{Detection, Detections};
use crate::effects::{StarImage, StarState};
use crate::statistics::order::sort_by_key;

/// A frame whose identification was tried.
#[derive(Clone, Copy, Debug)]
pub struct FrameIdentification<'a> {
    /// Index of the frame in its recording.
    pub frame: usize,
    /// Its star images.
    pub detections: &'a Detections,
    /// The answer.
    pub identification: &'a Identification,
    /// The physics with which [`super::identify`] was told the directions of the catalogue's stars; `None`: their own.
    pub sky: Option<&'a SkyChain>,
    /// Julian years from the catalogue's epoch to the frame; stars without proper motion are the less certain the longer.
    pub years_since_epoch: f64,
    /// Electrons per DN; `None` where nobody says, or where the detections' flux and background are no measurement.
    pub gain_e_per_dn: Option<f64>,
}

/// The control points of a recording's frames (`frame_count` in all), for the calibrator.
///
/// `nominal` is the camera as its maker gives it (of the un-mirrored image); without one the median of the frames' own focal
/// lengths and k1 stands in, with the principal point in the middle. Frames of another size or handedness than most are left
/// out; the second value names each with the reason.
#[must_use]
pub fn control_points(
    frames: &[FrameIdentification<'_>],
    frame_count: usize,
    catalog: &Catalog,
    nominal: Option<Camera>,
) -> (ControlPoints, Vec<String>) {
    let solved: Vec<(&FrameIdentification<'_>, &Solution)> = frames
        .iter()
        .filter_map(|frame| match frame.identification {
            Identification::Identified(solution) => Some((frame, solution)),
            Identification::NotIdentified { .. } => None,
        })
        .collect();
    let mirrored = solved.iter().filter(|(_, solution)| solution.parity < 0).count();
    let parity: i8 = if 2 * mirrored > solved.len() { -1 } else { 1 };
    let nominal_is_found = nominal.is_none();
    let projection = common_projection(solved.iter().map(|(_, solution)| solution.projection));
    let nominal = nominal.unwrap_or_else(|| median_camera(&solved, frames, projection));
    let mut left_out = Vec::new();
    let mut attitudes = vec![None; frame_count];
    let mut points = Vec::new();
    for (frame, solution) in solved {
        if solution.parity != parity {
            left_out
                .push(format!("Frame {} is mirrored otherwise than most: it is left out, since one camera cannot do both.", frame.frame));
            continue;
        }
        if (solution.camera.width_px, solution.camera.height_px) != (nominal.width_px, nominal.height_px) {
            left_out.push(format!(
                "Frame {} has {}×{} pixels where the camera has {}×{}: it is left out; give frames of one size.",
                frame.frame, solution.camera.width_px, solution.camera.height_px, nominal.width_px, nominal.height_px
            ));
            continue;
        }
        let Some(attitude) = attitudes.get_mut(frame.frame) else {
            left_out.push(format!("Frame {} lies beyond the {frame_count} frames of the recording: it is left out.", frame.frame));
            continue;
        };
        *attitude = Some(solution.attitude);
        let slope = BackgroundSlope::of(frame.detections);
        points.extend(solution.matches.iter().map(|matched| {
            let (star, detection) = (&catalog.stars[matched.star], &frame.detections.stars[matched.detection]);
            let own = Direction::from_unit(star.direction.xyz);
            ControlPoint {
                frame: frame.frame,
                hip: star.hip,
                direction: frame.sky.map_or(own, |sky| sky.apparent(star, catalog.epoch_yr)),
                x_px: detection.x_px,
                y_px: detection.y_px,
                covariance_px2: detection.covariance_px2,
                catalog_sigma_rad: catalog.position_sigma_rad(star, frame.years_since_epoch),
                has_proper_motion: star.proper_motion_rad_yr.is_some(),
                magnitude: star.magnitude,
                colour: star.colour,
                star: StarState::of(star, catalog.epoch_yr),
                image: image_state(detection, slope.as_ref(), frame.gain_e_per_dn),
            }
        }));
    }
    sort_by_key(&mut points, |point| point.frame);
    tell_gradient(&mut points);
    (ControlPoints { projection, nominal_is_found, parity, ..ControlPoints::new(nominal, attitudes, points) }, left_out)
}

/// What a detection tells of its image, and its frame of the background's slope there (`None`: it was not measured).
#[must_use]
pub fn image_state(detection: &Detection, slope: Option<&BackgroundSlope>, gain_e_per_dn: Option<f64>) -> StarImage {
    let gradient = slope.map(|slope| slope.at(detection.x_px, detection.y_px));
    StarImage {
        flux_e: gain_e_per_dn.map(|gain| detection.flux_dn * gain),
        background_gradient_e_px: gain_e_per_dn.and_then(|gain| gradient.map(|gradient| gradient.map(|along| along * gain))),
        psf_sigma_px: Some(detection.width_px),
        ..StarImage::default()
    }
}

/// Tells every image the root mean square of all images' gradients of the background.
fn tell_gradient(points: &mut [ControlPoint]) {
    let squares: Vec<f64> = points.iter().filter_map(|point| point.image.background_gradient_e_px.map(|[x, y]| x * x + y * y)).collect();
    if squares.is_empty() {
        return;
    }
    let rms = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
    for point in points {
        point.image.recording_gradient_e_px = Some(rms);
    }
}

/// The projection that most frames were identified with; of equally many the plainer.
#[must_use]
pub fn common_projection(all: impl Iterator<Item = Projection>) -> Projection {
    let all: Vec<Projection> = all.collect();
    let count = |one: &Projection| all.iter().filter(|other| *other == one).count();
    let fisheyes = Projection::FISHEYES.into_iter();
    fisheyes.fold(Projection::Pinhole, |most, other| if count(&other) > count(&most) { other } else { most })
}

fn median_camera(solved: &[(&FrameIdentification<'_>, &Solution)], frames: &[FrameIdentification<'_>], projection: Projection) -> Camera {
    let of_most = || solved.iter().filter(|(_, solution)| solution.projection == projection);
    let median = |value: fn(&Camera) -> f64| {
        let mut values: Vec<f64> = of_most().map(|(_, solution)| value(&solution.camera)).collect();
        values.sort_unstable_by(f64::total_cmp);
        values.get(values.len() / 2).copied()
    };
    // The size that most frames have; of equally many the larger.
    let mut sizes: Vec<(usize, usize)> = solved.iter().map(|(_, solution)| (solution.camera.width_px, solution.camera.height_px)).collect();
    if sizes.is_empty() {
        sizes = frames.iter().map(|frame| (frame.detections.width_px, frame.detections.height_px)).collect();
    }
    let count = |size: &(usize, usize)| sizes.iter().filter(|other| *other == size).count();
    let (width_px, height_px) = sizes.iter().copied().max_by_key(|size| (count(size), *size)).unwrap_or((1, 1));
    let focal_px = median(|camera| camera.focal_length_px).unwrap_or(width_px.max(height_px) as f64);
    let camera = Camera { k1: median(|camera| camera.k1).unwrap_or(0.0), ..Camera::pinhole(width_px, height_px, focal_px) };
    // Of a fisheye a frame tells the principal point too; of frames of another size it is that of the frame.
    let own = |axis: fn(&Camera) -> f64, middle: f64| median(axis).filter(|_| projection != Projection::Pinhole).unwrap_or(middle);
    let [x0, y0] = camera.principal_point_px;
    let principal_point_px = [own(|camera| camera.principal_point_px[0], x0), own(|camera| camera.principal_point_px[1], y0)];
    Camera { principal_point_px, ..camera }
}

impl ControlPoints {
    /// The same points in the un-mirrored image, in which `nominal`, the attitudes and every camera live: x becomes
    /// width − 1 − x where the images are mirrored. What is solved in it goes back to the file's coordinates through
    /// [`Camera::mirrored`].
    #[must_use]
    pub fn unmirrored(&self) -> Self {
        let mut all = self.clone();
        if self.parity < 0 {
            for point in &mut all.points {
                point.x_px = self.nominal.width_px as f64 - 1.0 - point.x_px;
                point.covariance_px2[1] = -point.covariance_px2[1];
                point.image = point.image.mirrored();
            }
            all.parity = 1;
        }
        all
    }
}

impl Camera {
    /// The camera of the mirrored image: a point at (width − 1 − x, y) has here the direction that it has there at (x, y), but
    /// for the sign of the first component.
    #[must_use]
    pub fn mirrored(&self) -> Self {
        let [x0, y0] = self.principal_point_px;
        Self { principal_point_px: [self.width_px as f64 - 1.0 - x0, y0], p1: -self.p1, ..*self }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::coordinates::PixelPoint;

    #[test]
    fn the_mirrored_camera_sees_the_mirrored_point_in_the_mirrored_direction() {
        let mut camera = Camera::pinhole(640, 480, 700.0);
        camera = camera.with_parameters([311.0, 246.0, 700.0, 3e-8, 2e-6, -4e-6]);
        let mirrored = camera.mirrored();
        for (x_px, y_px) in [(0.0, 0.0), (100.25, 400.5), (639.0, 12.0)] {
            let [x, y, z] = camera.direction(PixelPoint { x_px, y_px }).xyz;
            let other = mirrored.direction(PixelPoint { x_px: 639.0 - x_px, y_px }).xyz;
            for (a, b) in other.into_iter().zip([-x, y, z]) {
                assert!((a - b).abs() < 1e-15);
            }
        }
        assert_eq!(mirrored.mirrored(), camera);
    }
}
