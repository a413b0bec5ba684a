//! What is made of an identification: control points, deliberate errors, and the frame's place on the sky.

use boresight::catalog::Catalog;
use boresight::coordinates::{Attitude, Direction};
use boresight::identify::{
    ControlPoint, ControlPoints, FrameIdentification, Identification, IdentifyOptions, Misidentification, MisidentificationKind,
    control_points, identify, misidentify,
};
use nalgebra::Vector3;

use super::{BASE, DEG, List, Scene, Told, make, sky};

/// Identified frames of one simulated camera, as control points.
fn night(mirrored: bool) -> (Vec<List>, ControlPoints) {
    let (catalog, index) = sky();
    let scene = Scene { faintest: 6.5, mirrored, noise_px: 0.05, ..BASE };
    let frames: Vec<List> = (0..4).map(|seed| make(&scene, Told::Nothing, 300 + seed)).collect();
    let answers: Vec<Identification> =
        frames.iter().map(|made| identify(&made.detections, catalog, index, &[], &IdentifyOptions::default())).collect();
    let identified: Vec<FrameIdentification<'_>> = frames
        .iter()
        .zip(&answers)
        .enumerate()
        .map(|(frame, (made, identification))| FrameIdentification {
            frame,
            detections: &made.detections,
            identification,
            sky: None,
            years_since_epoch: 30.0,
            gain_e_per_dn: Some(2.0),
        })
        .collect();
    let (points, left_out) = control_points(&identified, frames.len(), catalog, None);
    assert!(left_out.is_empty(), "{left_out:?}");
    (frames, points)
}

#[test]
fn control_points_lie_where_their_stars_are_seen_in_plain_and_in_mirrored_images() {
    for mirrored in [false, true] {
        let (frames, points) = night(mirrored);
        assert_eq!(points.parity, if mirrored { -1 } else { 1 });
        assert!(points.points.len() > 60, "{}", points.points.len());
        assert!((points.nominal.focal_length_px / frames[0].focal_px - 1.0).abs() < 1e-3);
        for (point, file) in points.unmirrored().points.iter().zip(&points.points) {
            let attitude = points.attitudes[point.frame].unwrap();
            let seen = points.nominal.pixel(&attitude.camera_from_apparent(&point.direction)).unwrap();
            assert!((seen.x_px - point.x_px).hypot(seen.y_px - point.y_px) < 2.0, "{point:?} {seen:?}");
            assert_eq!(file.x_px, if mirrored { 1023.0 - point.x_px } else { point.x_px });
            let stars = &frames[point.frame].detections.stars;
            let detection =
                stars.iter().find(|star| star.x_px == file.x_px && star.y_px == file.y_px).expect("it is one of the detections");
            // Two electrons per DN.
            assert_eq!((point.image.flux_e, point.image.psf_sigma_px), (Some(2.0 * detection.flux_dn), Some(detection.width_px)));
            let [along_x, along_y] = detection.background_gradient_dn.map(|gradient| 2.0 * gradient);
            let expected = [if mirrored { -along_x } else { along_x }, along_y];
            let gradient = point.image.background_gradient_e_px.unwrap();
            assert!((0..2).all(|axis| (gradient[axis] - expected[axis]).abs() < 1e-12), "{gradient:?} {expected:?}");
            assert!((point.image.recording_gradient_e_px.unwrap() - 0.1).abs() < 1e-12, "{:?}", point.image);
            let star = Catalog::embedded().by_hip(point.hip).unwrap();
            assert!(point.catalog_sigma_rad > 0.0 && point.has_proper_motion == star.proper_motion_rad_yr.is_some());
        }
    }
}

#[test]
fn deliberate_misidentification_changes_the_stated_share_and_says_which() {
    let catalog = Catalog::embedded();
    let (_, right) = night(false);
    for kind in [MisidentificationKind::Random, MisidentificationKind::NearNeighbour] {
        let mut wrong = right.clone();
        let (truth, too_few) = misidentify(&mut wrong, catalog, 0.2, kind, 7);
        assert!(too_few.is_none());
        assert_eq!(truth.len(), (0.2 * right.points.len() as f64).round() as usize);
        let changed: Vec<usize> = (0..right.points.len()).filter(|&i| right.points[i].direction != wrong.points[i].direction).collect();
        assert_eq!(changed, truth.iter().map(|t| t.point).collect::<Vec<_>>());
        for t in &truth {
            let (before, after) = (&right.points[t.point], &wrong.points[t.point]);
            assert_eq!((before.x_px, before.y_px, before.frame, before.hip), (after.x_px, after.y_px, after.frame, t.true_hip));
            assert!((after.direction.angle_rad(&before.direction) - t.error_rad).abs() < 1e-12 && t.error_rad < 2.001 * DEG);
            match (kind, t.given_hip) {
                (MisidentificationKind::NearNeighbour, Some(hip)) => {
                    let star = catalog.by_hip(hip).unwrap();
                    assert!(
                        hip != t.true_hip
                            && after.hip == hip
                            && star.direction.angle_rad(&Direction::from_unit(after.direction.xyz)) < 1e-9
                    );
                }
                _ => assert!(t.given_hip.is_none() && t.error_rad > 0.0499 * DEG, "{t:?}"),
            }
        }
        let mut again = right.clone();
        assert_eq!(misidentify(&mut again, catalog, 0.2, kind, 7).0, truth);
        assert_eq!(again, wrong);
        assert_ne!(misidentify(&mut again, catalog, 0.2, kind, 8).0, truth);
    }
    let mut none = right.clone();
    for kind in [MisidentificationKind::Random, MisidentificationKind::NearNeighbour, MisidentificationKind::WrongCamera] {
        assert_eq!(misidentify(&mut none, catalog, 0.0, kind, 1), (Vec::new(), None));
        assert_eq!(none, right);
    }
}

/// The cosines of the angles between the errors of wrong points of one frame that are neighbours.
fn likeness(right: &ControlPoints, wrong: &ControlPoints, truth: &[Misidentification]) -> Vec<f64> {
    let error = |t: &Misidentification| {
        let [before, after] = [right, wrong].map(|points| Vector3::from(points.points[t.point].direction.xyz));
        (right.points[t.point].frame, before, (after - before).normalize())
    };
    let errors: Vec<_> = truth.iter().map(error).collect();
    let pairs = errors.iter().enumerate().flat_map(|(i, a)| errors[..i].iter().map(move |b| (a, b)));
    pairs.filter(|(a, b)| a.0 == b.0 && a.1.angle(&b.1) < 4.0 * DEG).map(|(a, b)| a.2.dot(&b.2)).collect()
}

#[test]
fn natural_misidentification_is_that_of_one_wrong_camera() {
    let catalog = Catalog::embedded();
    let (_, right) = night(false);
    for (share, seed) in [(0.05, 1), (0.1, 2), (0.2, 3), (0.4, 4)] {
        let mut wrong = right.clone();
        let (truth, too_few) = misidentify(&mut wrong, catalog, share, MisidentificationKind::WrongCamera, seed);
        assert!(too_few.is_none());
        assert_eq!(truth.len(), (share * right.points.len() as f64).round() as usize);
        // Points that are not listed are as they were, and of the others all that a measurement tells.
        let listed: Vec<usize> = truth.iter().map(|t| t.point).collect();
        assert!((0..right.points.len()).all(|i| listed.contains(&i) == (right.points[i] != wrong.points[i])));
        assert_eq!((&right.attitudes, &right.frames, right.nominal), (&wrong.attitudes, &wrong.frames, wrong.nominal));
        for t in &truth {
            let (before, after) = (&right.points[t.point], &wrong.points[t.point]);
            let star = catalog.by_hip(t.given_hip.unwrap()).unwrap();
            let as_measured = ControlPoint {
                hip: star.hip,
                direction: after.direction,
                magnitude: star.magnitude,
                colour: star.colour,
                has_proper_motion: star.proper_motion_rad_yr.is_some(),
                star: after.star,
                ..*before
            };
            assert_eq!(*after, as_measured);
            assert_eq!(before.hip, t.true_hip);
            assert_ne!(after.hip, before.hip);
            // A star that this camera could see: what a direction by chance or any neighbour need not be.
            let faintest = right.points.iter().filter(|point| point.frame == before.frame).map(|point| point.magnitude).fold(0.0, f64::max);
            assert!(star.magnitude <= faintest, "V {} where the faintest is {faintest}", star.magnitude);
            assert!(star.direction.angle_rad(&Direction::from_unit(after.direction.xyz)) < 1e-9);
            assert!((after.direction.angle_rad(&before.direction) - t.error_rad).abs() < 1e-12);
        }
        let mut again = right.clone();
        assert_eq!(misidentify(&mut again, catalog, share, MisidentificationKind::WrongCamera, seed), (truth.clone(), None));
        assert_eq!(again, wrong);
        assert_ne!(misidentify(&mut right.clone(), catalog, share, MisidentificationKind::WrongCamera, seed + 10).0, truth);
        // Attitudes only say where the middle of a frame is: without them it is that of its stars.
        let mut unknown = right.clone();
        unknown.attitudes.fill(None);
        let (without, too_few) = misidentify(&mut unknown, catalog, share, MisidentificationKind::WrongCamera, seed);
        assert_eq!((without.len(), too_few), (truth.len(), None));
    }
    let mean_of = |kind, share| {
        let cosines = (0..12).flat_map(|seed| {
            let mut wrong = right.clone();
            let (truth, _) = misidentify(&mut wrong, catalog, share, kind, seed);
            likeness(&right, &wrong, &truth)
        });
        let cosines: Vec<f64> = cosines.collect();
        (cosines.iter().sum::<f64>() / cosines.len() as f64, cosines.len())
    };
    for share in [0.1, 0.2, 0.4] {
        let (natural, pairs) = mean_of(MisidentificationKind::WrongCamera, share);
        let (random, random_pairs) = mean_of(MisidentificationKind::Random, share);
        println!(
            "share {share}: errors of neighbours are alike to {natural:.2} ({pairs} pairs), random ones to {random:.2} ({random_pairs})"
        );
        // The mean of n cosines of angles by chance has the standard deviation 1/√(2n).
        assert!(pairs > 100 && natural > 0.4, "{natural} of {pairs}");
        assert!(random_pairs > 50 && random.abs() < 4.0 / (2.0 * random_pairs as f64).sqrt(), "{random} of {random_pairs}");
    }
    // No camera makes every star wrong, and that is said.
    let mut all = right.clone();
    let (truth, too_few) = misidentify(&mut all, catalog, 1.0, MisidentificationKind::WrongCamera, 5);
    let sentence = too_few.unwrap();
    assert!(truth.len() < right.points.len());
    assert!(
        sentence.starts_with(&format!("Only {} of the {} wrong", truth.len(), right.points.len())) && sentence.ends_with('.'),
        "{sentence}"
    );
    // A star alone has no other that it could be.
    let mut alone = ControlPoints::new(right.nominal, right.attitudes.clone(), right.points[..1].to_vec());
    alone.points[0].magnitude = -30.0;
    let (truth, too_few) = misidentify(&mut alone, catalog, 1.0, MisidentificationKind::WrongCamera, 5);
    assert!(truth.is_empty() && too_few.is_some_and(|sentence| sentence.starts_with("Only 0 of the 1 wrong")));
}

#[test]
fn centre_roll_and_width_follow_their_definitions() {
    let (catalog, index) = sky();
    for (seed, mirrored) in [(1, false), (2, true), (3, false)] {
        let scene = Scene { mirrored, noise_px: 0.01, aspect: 4.0 / 3.0, faintest: 6.5, ..BASE };
        let made = make(&scene, Told::Nothing, seed);
        let Identification::Identified(solution) = identify(&made.detections, catalog, index, &[], &IdentifyOptions::default()) else {
            panic!("seed {seed} is not identified")
        };
        assert!((solution.width_deg() - 15.0).abs() < 0.01, "{}", solution.width_deg());
        let height = 2.0 * (384.0 / made.focal_px).atan() / DEG;
        assert!((solution.height_deg() - height).abs() < 0.01, "{}", solution.height_deg());
        // The attitude of that pointing and roll is the attitude found.
        let (ra, dec) = solution.centre().radec_rad();
        let again = Attitude::from_pointing(ra, dec, solution.roll_deg() * DEG);
        assert!(again.camera_from_icrs.angle_to(&solution.attitude.camera_from_icrs) < 1e-6);
        assert!(again.camera_from_icrs.angle_to(&made.attitude.camera_from_icrs) < 1e-3);
        let matches = &solution.matches;
        let mut stars: Vec<usize> = matches.iter().map(|m| m.star).collect();
        stars.sort_unstable();
        stars.dedup();
        assert_eq!(stars.len(), matches.len(), "a star is used twice");
    }
}
