//! Nights made for trying calibrators on are what they say.

use std::collections::BTreeSet;

use boresight::calibrate::trial::{Trial, TrialNight, WrongStars};
use boresight::calibrate::{Method, calibrate, mapping_error_px};
use boresight::catalog::Catalog;
use boresight::coordinates::PixelPoint;
use boresight::identify::{ControlPoint, MisidentificationKind, misidentify};
use boresight::units::DEG_RAD;

use super::options;

const KINDS: [WrongStars; 3] = [WrongStars::Random, WrongStars::NearNeighbour, WrongStars::NATURAL];

fn night(wrong_stars: WrongStars, wrong_share: f64, seed: u64) -> TrialNight {
    Trial { wrong_stars, wrong_share, ..Trial::published() }.night(Catalog::embedded(), seed)
}

/// Measured minus where the camera that took the frame images the star that it is.
fn error_px(night: &TrialNight, index: usize) -> [f64; 2] {
    let point = &night.control_points.points[index];
    let star = Catalog::embedded().by_hip(night.true_hip[index]).unwrap();
    let direction = boresight::coordinates::Direction::from_unit(star.direction.xyz);
    let image = night.truth.pixel(&night.attitudes[point.frame].camera_from_apparent(&direction)).unwrap();
    [point.x_px - image.x_px, point.y_px - image.y_px]
}

#[test]
fn points_are_stars_of_the_catalogue_measured_with_the_stated_noise() {
    let (mut square, mut count) = (0.0, 0.0);
    for seed in 0..20 {
        let night = night(WrongStars::Random, 0.0, seed);
        assert_eq!(night.control_points.points.len(), 12 * 25);
        assert!(!night.wrong.contains(&true));
        for (index, point) in night.control_points.points.iter().enumerate() {
            assert_eq!(point.hip, night.true_hip[index]);
            assert_eq!(point.direction.xyz, Catalog::embedded().by_hip(point.hip).unwrap().direction.xyz);
            assert_eq!(point.star.direction, point.direction.xyz);
            let [x, y] = error_px(&night, index);
            square += x * x + y * y;
            count += 2.0;
        }
        for (start, attitude) in night.control_points.attitudes.iter().zip(&night.attitudes) {
            let angle = start.unwrap().camera_from_icrs.angle_to(&attitude.camera_from_icrs);
            assert!(angle > 0.0 && angle < 6.0 * 0.1 * DEG_RAD, "{angle}");
        }
    }
    // 12 000 values: 0.65 % standard error.
    let sigma = (square / count).sqrt();
    assert!((sigma / 0.1 - 1.0).abs() < 0.03, "{sigma}");
    let blind = Trial { attitude_sigma_rad: None, ..Trial::published() }.night(Catalog::embedded(), 0);
    assert_eq!(blind.control_points.attitudes, vec![None; 12]);
}

#[test]
fn the_brightest_of_the_field_are_taken() {
    let few = Trial { stars_per_frame: 8, frames: 1, ..Trial::published() }.night(Catalog::embedded(), 4);
    let many = Trial { frames: 1, ..Trial::published() }.night(Catalog::embedded(), 4);
    assert_eq!(few.true_hip, many.true_hip[..8]);
    let all = Trial { stars_per_frame: usize::MAX, frames: 1, ..Trial::published() }.night(Catalog::embedded(), 4);
    // 20.7° × 20.7° of about 41 000 stars over the whole sky: about 430.
    assert!((150..1200).contains(&all.true_hip.len()), "{}", all.true_hip.len());
}

#[test]
fn wrong_stars_are_the_stated_share_and_nothing_else_changes() {
    let clean = night(WrongStars::Random, 0.0, 9);
    for kind in KINDS {
        let night_of_kind = night(kind, 0.3, 9);
        assert_eq!(night_of_kind, night(kind, 0.3, 9), "the same seed gives the same night");
        assert_ne!(night_of_kind.true_hip, night(kind, 0.3, 10).true_hip);
        assert_eq!(night_of_kind.wrong.iter().filter(|wrong| **wrong).count(), 90, "{kind:?}");
        assert_eq!((&night_of_kind.true_hip, &night_of_kind.attitudes), (&clean.true_hip, &clean.attitudes));
        let points = night_of_kind.control_points.points.iter().zip(&clean.control_points.points);
        for ((point, right), wrong) in points.zip(&night_of_kind.wrong) {
            assert_eq!((point.x_px, point.y_px), (right.x_px, right.y_px));
            assert_eq!(point == right, !wrong);
            let angle = point.direction.angle_rad(&right.direction);
            assert!(angle < 2.5 * DEG_RAD, "{kind:?}: {angle}");
        }
    }
}

#[test]
fn natural_wrong_stars_are_those_nearest_to_where_the_nominal_camera_points() {
    let catalog = Catalog::embedded();
    let night = night(WrongStars::NATURAL, 0.5, 21);
    let named: BTreeSet<(usize, u32)> = night.control_points.points.iter().map(|point| (point.frame, point.hip)).collect();
    assert_eq!(named.len(), night.wrong.len(), "no star is named twice in a frame");
    let nominal = night.control_points.nominal;
    let seen = |point: &ControlPoint| {
        let pixel = PixelPoint { x_px: point.x_px, y_px: point.y_px };
        night.attitudes[point.frame].apparent_from_camera(&nominal.direction(pixel))
    };
    for (point, true_hip) in night.control_points.points.iter().zip(&night.true_hip).filter(|(point, hip)| point.hip != **hip) {
        let place = seen(point);
        let given = point.direction.angle_rad(&place);
        let centre = boresight::coordinates::Direction::from_unit(place.xyz);
        let nearer = catalog.stars_within(&centre, given * (1.0 - 1e-9), f64::INFINITY);
        // Every star that lies nearer is the right one, or named in the frame, or was when this one was chosen.
        let in_frame =
            |hip: u32| (0..night.wrong.len()).any(|i| night.control_points.points[i].frame == point.frame && night.true_hip[i] == hip);
        let free =
            nearer.into_iter().map(|star| catalog.stars[star].hip).find(|hip| !in_frame(*hip) && !named.contains(&(point.frame, *hip)));
        assert_eq!(free, None, "HIP {true_hip} in frame {} was named HIP {}", point.frame, point.hip);
    }
    // A wrong star lies on the side on which the nominal camera errs: the mean offset along the nominal error is positive.
    let along: f64 = (0..night.wrong.len())
        .filter(|index| night.wrong[*index])
        .map(|index| {
            let point = &night.control_points.points[index];
            let right = catalog.by_hip(night.true_hip[index]).unwrap().direction.xyz;
            let place = seen(point).xyz;
            (0..3).map(|axis| (point.direction.xyz[axis] - right[axis]) * (place[axis] - right[axis])).sum::<f64>()
        })
        .sum();
    assert!(along > 0.0, "{along}");
}

#[test]
fn a_clean_night_gives_its_camera_back() {
    let night = night(WrongStars::Random, 0.0, 2);
    let result = calibrate(&night.control_points, &options(Method::VariableWeights)).unwrap();
    let error = mapping_error_px(&night.truth, &result.camera).unwrap();
    assert!(error.rms_px < 0.06, "{error:?}");
}

#[test]
fn names_given_through_a_wrong_camera_do_little_harm_to_either_method() {
    let catalog = Catalog::embedded();
    for (method, limits) in [(Method::Bundle, [1.2, 1.3]), (Method::VariableWeights, [1.3, 1.4])] {
        for (share, limit) in [0.1, 0.2].into_iter().zip(limits) {
            // Against the same night with the wrong stars left out by the truth.
            let ratios = (0..6).map(|seed| {
                let night = night(WrongStars::Random, 0.0, 500 + seed);
                let mut points = night.control_points.clone();
                let (wrong, too_few) = misidentify(&mut points, catalog, share, MisidentificationKind::WrongCamera, seed);
                assert_eq!((wrong.len(), too_few), ((share * 300.0).round() as usize, None));
                let mut known = night.control_points.clone();
                let mut index = 0..;
                known.points.retain(|_| index.next().is_some_and(|index| wrong.iter().all(|wrong| wrong.point != index)));
                let error = |points| mapping_error_px(&night.truth, &calibrate(points, &options(method)).unwrap().camera).unwrap().rms_px;
                (error(&points), error(&known))
            });
            let (errors, bests): (Vec<f64>, Vec<f64>) = ratios.unzip();
            let rms = |all: &[f64]| (all.iter().map(|error| error * error).sum::<f64>() / all.len() as f64).sqrt();
            let (error, best) = (rms(&errors), rms(&bests));
            println!("{method:?}, {share}: {error:.4} px, {best:.4} px without the wrong stars; {errors:.4?}");
            assert!(error < limit * best, "{method:?}, {share}: {error} px, {best} px without the wrong stars");
        }
    }
}
