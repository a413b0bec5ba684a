//! Blends with catalogue stars that were not detected: star images in the light of a neighbour that the catalogue knows and the measurement did
//! not.
//!
//! A faint star beside a brighter one draws its centre. To first order of a fit that weights pixels by their variance V = sky + image, with P
//! the image's profile and N that of the neighbour, the shift is Σ (∂P·N/V)/Σ (∂P²/V) times the ratio q of the fluxes: q·d·e^(−d²/4s²) for a
//! faint image of width s and a neighbour at the distance d, and up to q·d for a bright one. Where both were found the fit has parted them;
//! where the neighbour was not, the centre is off by more than its error says, along no law that a diagnosis knows but the background's
//! gradient. Such images take no part. In a recording of 30 frames at 147″ a pixel their squared errors were 4 and 13 times the stated ones (shifts of one to three, and
//! more than three standard errors), those of all others 1.06 times.

use std::collections::BTreeMap;

use nalgebra::Vector3;

use super::{Measured, image_conditions};
use crate::catalog::Catalog;
use crate::coordinates::{Direction, Icrs};
use crate::identify::{ControlPoint, ControlPoints};

/// An image takes no part if its neighbours draw it by more than this share of its standard error.
const MAX_SIGMAS: f64 = 0.25;
/// Neighbours are looked for within so many widths of the image.
const REACH_SIGMAS: f64 = 6.0;
/// A neighbour was measured itself if a star was found so near to its place, px.
const SAME_PX: f64 = 1.0;
/// A pixel's own variance, px².
const PIXEL_PX2: f64 = 1.0 / 12.0;
/// Directions this near to the rim of the half space in front (cosine) have no place on a plane.
const MIN_Z: f64 = 0.3;

/// Takes out of the points (of the un-mirrored image; `parity` −1 where the files' is mirrored) those that stand in the light of stars that
/// were not measured, and hands them over.
pub(super) fn take_disturbed(points: &mut ControlPoints, parity: i8, measured: &Measured, catalog: &Catalog) -> Vec<ControlPoint> {
    if measured.recording.stars.is_some() {
        return Vec::new(); // a list's centres are as good as it says
    }
    let width_px = points.nominal.width_px as f64;
    let found: BTreeMap<usize, Vec<[f64; 2]>> = measured
        .frames
        .iter()
        .map(|frame| {
            let place = |star: &crate::detect::Detection| [if parity < 0 { width_px - 1.0 - star.x_px } else { star.x_px }, star.y_px];
            (frame.index, frame.detections.stars.iter().map(place).collect())
        })
        .collect();
    let all = std::mem::take(&mut points.points);
    let none = Vec::new();
    let field = Field { points, catalog, sky_e2: image_conditions(measured).map(|looks| looks.noise_e * looks.noise_e) };
    let (disturbed, kept) = all.into_iter().partition(|point| field.disturbs(point, found.get(&point.frame).unwrap_or(&none)));
    points.points = kept;
    disturbed
}

/// That they were left out.
pub(super) fn sentence(left_out: usize, kept: usize) -> Option<String> {
    let all = left_out + kept;
    (left_out > 0).then(|| {
        format!(
            "{left_out} of {all} star images stand in the light of catalogue stars that were not measured apart from them, and take no part"
        )
    })
}

/// What the neighbours are known from.
struct Field<'a> {
    points: &'a ControlPoints,
    catalog: &'a Catalog,
    /// Variance of a pixel of the sky, electrons², where it is known.
    sky_e2: Option<f64>,
}

impl Field<'_> {
    /// Whether neighbours draw this image by more than it is known; `found`: the stars found in its frame.
    fn disturbs(&self, point: &ControlPoint, found: &[[f64; 2]]) -> bool {
        let Self { points, catalog, sky_e2 } = *self;
        let attitude = points.attitudes.get(point.frame).copied().flatten();
        let (Some(attitude), Some(sigma_px)) = (attitude, point.image.psf_sigma_px.filter(|sigma| *sigma > 0.0)) else { return false };
        let focal_px = points.nominal.focal_length_px;
        let catalogued = point.star.direction;
        let near = catalog.stars_within(&Direction::<Icrs>::along(catalogued), REACH_SIGMAS * sigma_px / focal_px, f64::INFINITY);
        let place = |direction: Vector3<f64>| {
            let [x, y, z]: [f64; 3] = (attitude.camera_from_icrs * direction).into();
            (z > MIN_Z).then(|| [focal_px * x / z, focal_px * y / z])
        };
        let apparent = Vector3::from(point.direction.xyz);
        let Some(own) = place(apparent) else { return false };
        let square_px2 = sigma_px * sigma_px + PIXEL_PX2;
        // Where electrons are not known all pixels weigh the same, as in a faint image.
        let sky_share = sky_e2.zip(point.image.flux_e.filter(|flux| *flux > 0.0)).map_or(f64::INFINITY, |(sky, flux)| sky / flux);
        let mut drawn = [0.0; 2];
        for star in near.into_iter().map(|index| &catalog.stars[index]).filter(|star| star.direction.xyz != catalogued) {
            // What the sky does to the one star's light it does to the other's.
            let Some(other) = place(apparent + Vector3::from(star.direction.xyz) - Vector3::from(catalogued)) else { continue };
            let away = [other[0] - own[0], other[1] - own[1]];
            let is_found = |at: &[f64; 2]| {
                let to = |x: f64, y: f64| (at[0] - point.x_px - x).hypot(at[1] - point.y_px - y);
                to(away[0], away[1]) < SAME_PX && to(0.0, 0.0) > 0.0
            };
            let ratio = 10.0_f64.powf(-0.4 * (star.magnitude - point.star.magnitude));
            if !ratio.is_finite() || found.iter().any(is_found) {
                continue;
            }
            let by = shift_px(away, square_px2, sky_share);
            drawn = [drawn[0] + ratio * by[0], drawn[1] + ratio * by[1]];
        }
        let [xx, _, yy] = point.covariance_px2;
        drawn[0].hypot(drawn[1]) > MAX_SIGMAS * (0.5 * (xx + yy)).sqrt()
    }
}

/// How far a neighbour of the same flux would draw the centre, px, if that were little. `sky_share`: variance of a pixel of the sky over the
/// image's electrons.
fn shift_px(away: [f64; 2], square_px2: f64, sky_share: f64) -> [f64; 2] {
    /// How far the fit looks, in widths.
    const WINDOW_SIGMAS: f64 = 4.0;
    let half = (WINDOW_SIGMAS * square_px2.sqrt()).ceil() as i32;
    let profile = |x: f64, y: f64| (-(x * x + y * y) / (2.0 * square_px2)).exp() / (std::f64::consts::TAU * square_px2);
    let (mut pull, mut stiffness) = ([0.0; 2], [0.0; 2]);
    for (x, y) in (-half..=half).flat_map(|y| (-half..=half).map(move |x| (f64::from(x), f64::from(y)))) {
        let own = profile(x, y);
        let weight = if sky_share.is_finite() { 1.0 / (sky_share + own) } else { 1.0 };
        let slope = [x, y].map(|along| own * along / square_px2);
        for axis in 0..2 {
            pull[axis] += weight * slope[axis] * profile(x - away[0], y - away[1]);
            stiffness[axis] += weight * slope[axis] * slope[axis];
        }
    }
    [pull[0] / stiffness[0], pull[1] / stiffness[1]]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Camera;
    use crate::catalog::Star;
    use crate::coordinates::Attitude;
    use crate::effects::{StarImage, StarState};

    const FOCAL_PX: f64 = 1000.0;

    /// A star of V = 5 on the axis, and one of another magnitude so many px beside it.
    fn pair(away_px: f64, magnitude: f64) -> Catalog {
        let star = |hip: u32, x: f64, magnitude: f64| Star {
            hip,
            direction: Direction::along([x, 0.0, 1.0]),
            proper_motion_rad_yr: None,
            parallax_rad: 0.0,
            magnitude,
            colour: None,
        };
        Catalog::new(vec![star(1, 0.0, 5.0), star(2, away_px / FOCAL_PX, magnitude)], 2000.0, String::new(), String::new())
    }

    fn disturbed(catalog: &Catalog, sigma_px: f64, found: &[[f64; 2]]) -> bool {
        let camera = Camera::pinhole(200, 200, FOCAL_PX);
        let star = *catalog.by_hip(1).unwrap();
        let point = ControlPoint {
            frame: 0,
            hip: 1,
            direction: Direction::along([0.0, 0.0, 1.0]),
            x_px: 99.5,
            y_px: 99.5,
            covariance_px2: [sigma_px * sigma_px, 0.0, sigma_px * sigma_px],
            catalog_sigma_rad: 0.0,
            has_proper_motion: false,
            magnitude: 5.0,
            colour: None,
            star: StarState::of(&star, 2000.0),
            image: StarImage { psf_sigma_px: Some(0.9), ..StarImage::default() },
        };
        let points = ControlPoints::new(camera, vec![Some(Attitude::new(nalgebra::UnitQuaternion::identity()))], vec![point]);
        Field { points: &points, catalog, sky_e2: None }.disturbs(&point, found)
    }

    /// A tenth of the light two pixels away draws the centre by 0.1·2·e^(−4/3.57) = 0.065 px, unless it was measured itself.
    #[test]
    fn a_neighbour_that_was_not_measured_disturbs_by_its_law() {
        let near = pair(2.0, 7.5);
        let own = [99.5, 99.5];
        for (sigma_px, expected) in [(0.02, true), (0.25, true), (0.27, false)] {
            assert_eq!(disturbed(&near, sigma_px, &[own]), expected, "{sigma_px}");
        }
        assert!(!disturbed(&near, 0.02, &[own, [101.6, 99.4]]), "the fit has parted them");
        assert!(disturbed(&near, 0.02, &[own, [97.5, 99.5]]), "another star on the other side");
        let faint = shift_px([2.0, 0.0], 0.81 + PIXEL_PX2, f64::INFINITY);
        assert!(
            (faint[0] / (2.0 * (-4.0_f64 / (4.0 * (0.81 + PIXEL_PX2))).exp()) - 1.0).abs() < 0.01 && faint[1].abs() < 1e-9,
            "{faint:?}"
        );
        assert!(!disturbed(&pair(6.0, 7.5), 0.02, &[own]) && !disturbed(&pair(2.0, 11.5), 0.02, &[own]), "too far, too faint");
    }

    /// The law beside the program's own fit of two stars, of which it knows one: faint and bright, near and far.
    #[test]
    fn the_law_is_that_of_the_fit() {
        use crate::detect::{FixedBackground, fit_forced};
        use crate::frame::Frame;
        use statrs::function::erf::erf;
        const SIDE: usize = 41;
        const SIGMA_PX: f64 = 0.9;
        let (sky_e, noise_e2) = (50.0, 75.0_f64);
        let edge = |at: f64| 0.5 * erf(at / (SIGMA_PX * std::f64::consts::SQRT_2));
        let share = |pixel: usize, at: f64| edge(pixel as f64 + 0.5 - at) - edge(pixel as f64 - 0.5 - at);
        let frame = |stars: &[([f64; 2], f64)]| {
            let light = |x: usize, y: usize| stars.iter().map(|(at, e)| e * share(x, at[0]) * share(y, at[1])).sum::<f64>() + sky_e;
            let pixels_dn = (0..SIDE * SIDE).map(|k| light(k % SIDE, k / SIDE) as f32).collect();
            Frame { width_px: SIDE, height_px: SIDE, pixels_dn, saturation_dn: f32::MAX }
        };
        let known = FixedBackground { background_dn: sky_e, noise_dn: noise_e2.sqrt(), gain_e_per_dn: 1.0, psf_sigma_px: SIGMA_PX };
        let ratio = 0.005;
        for flux_e in [2e3, 1e5] {
            for away in [0.5, 1.0, 2.0, 2.5] {
                let mut moved = 0.0;
                for phase in [-0.4, -0.15, 0.1, 0.35] {
                    let at = [20.0 + phase, 20.2];
                    let pair = [(at, flux_e), ([at[0] + away, at[1]], ratio * flux_e)];
                    let [alone, both] =
                        [&pair[..1], &pair[..]].map(|stars| fit_forced(&frame(stars), &[[20.0, 20.0]], &known)[0].unwrap().x_px);
                    moved += 0.25 * (both - alone);
                }
                let law = ratio * shift_px([away, 0.0], SIGMA_PX * SIGMA_PX + PIXEL_PX2, noise_e2 / flux_e)[0];
                println!("{flux_e} e-, neighbour at {away} px: {moved:.6} px, {:.2} of the law", moved / law);
                assert!((moved / law - 1.0).abs() < 0.03, "{flux_e} {away}: {moved} for {law}");
            }
        }
    }
}
