//! The channels beside places, on stars and noise drawn by chance: nothing where nothing is, and what is there with its size.

use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;

use super::expected_stars::StarMeasurement;
use super::judge::{Asked, Judged, Pixels, judge};
use super::noise_kind::DeclaredDetector;
use crate::detect::Moments;
use crate::effects::ImageContext;
use crate::pixel_statistics::{Estimate, FixedPattern, FrameNoise, LinePair, PatternPair, PixelStatistics, SkyMesh};

pub(super) const FRAMES: usize = 12;
const STARS: usize = 60;

/// What is added to magnitude and second moments of a star.
pub(super) type Added = fn(&ImageContext) -> (f64, [f64; 3]);

pub(super) fn nothing(_: &ImageContext) -> (f64, [f64; 3]) {
    (0.0, [0.0; 3])
}

/// Stars of a field seen at other places in every frame: each with an error of the catalogue that all its images share.
pub(super) fn stars(seed: u64, added: Added) -> Vec<StarMeasurement> {
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    let sky: Vec<(f64, f64, f64)> = (0..STARS)
        .map(|_| {
            let off: f64 = StandardNormal.sample(&mut rng);
            (3.0 + 4.0 * rng.random::<f64>(), 1.6 * rng.random::<f64>() - 0.6, 0.05 * off)
        })
        .collect();
    let mut all = Vec::new();
    for frame in 0..FRAMES {
        let shake: f64 = StandardNormal.sample(&mut rng);
        let (turn, length) = ((2.4 * frame as f64).sin_cos(), 0.5 + 0.1 * frame as f64);
        for (star, (magnitude, colour, off)) in sky.iter().enumerate() {
            let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
            let errors: [f64; 8] = std::array::from_fn(|_| normal());
            let image = ImageContext {
                at: [1.4 * rng.random::<f64>() - 0.7, 1.4 * rng.random::<f64>() - 0.7],
                phase_px: [rng.random::<f64>() - 0.5, rng.random::<f64>() - 0.5],
                colour_offset: Some(*colour),
                fullness: Some(10.0_f64.powf(-0.4 * (magnitude - 3.0))),
                background_fullness: 0.01,
                relative_flux: Some(10.0_f64.powf(-0.4 * (magnitude - 5.0))),
                rows_moved: rng.random::<f64>(),
                airmass: None,
                temperature_offset_k: None,
                time_offset_h: Some(frame as f64 / 2.0 - 2.75),
                trail_px: Some([length * turn.1, length * turn.0]),
                sigma_px: 1.0,
            };
            let (fainter, moments) = added(&image);
            let flux_dn = 10.0_f64.powf(-0.4 * (magnitude - 12.5));
            let flux_sigma_dn = (flux_dn + 300.0).sqrt();
            let measured_dn = flux_dn * 10.0_f64.powf(-0.4 * (fainter + off)) + flux_sigma_dn * errors[0];
            // The peak is measured with the light.
            let image = ImageContext {
                fullness: image.fullness.map(|fullness| fullness * measured_dn / flux_dn),
                relative_flux: image.relative_flux.map(|flux| flux * measured_dn / flux_dn),
                ..image
            };
            let sigma = 2.0 * flux_sigma_dn / flux_dn;
            let second = [1.0 + 0.01 * shake, 0.0, 1.0 + 0.01 * shake];
            all.push(StarMeasurement {
                point: all.len(),
                frame,
                star,
                magnitude: *magnitude,
                flux_dn: measured_dn,
                flux_sigma_dn,
                moments: Some(Moments {
                    second_px2: std::array::from_fn(|k| second[k] + moments[k] + sigma * errors[1 + k]),
                    second_sigma_px2: [sigma; 3],
                    skewness: [sigma * errors[4], sigma * errors[5]],
                    skewness_sigma: [sigma; 2],
                }),
                image,
            });
        }
    }
    all
}

pub(super) fn asked(alpha: f64) -> Asked<'static> {
    Asked { nulls: 200, alpha, seed: 1, other_questions: 0.0, stamps: None, looks_through_air: true, tested: &[] }
}

pub(super) fn found(judged: &Judged) -> Vec<&'static str> {
    let stands = judged.proposed.iter().filter(|own| own.against.is_empty());
    stands.map(|own| judged.rows.questions[own.question].id).collect()
}

/// Size of the first parameter of an effect that stands, with its standard error.
pub(super) fn size(judged: &Judged, id: &str) -> Option<[f64; 2]> {
    let is_own = |own: &&super::judge::Proposed| own.against.is_empty() && judged.rows.questions[own.question].id == id;
    judged.proposed.iter().find(is_own).map(|own| own.sizes[0])
}

#[test]
fn nothing_is_found_where_nothing_is() {
    const SEEDS: u64 = 24;
    let (mut proposed, mut left) = (0, 0);
    for seed in 0..SEEDS {
        let judged = judge(&stars(seed, nothing), None, FRAMES, &asked(0.05), &[]).unwrap();
        proposed += usize::from(!judged.proposed.is_empty());
        left += judged.channels.values().filter(|state| state.left_p_value < 0.025).count();
    }
    // One of 24 is due at α = 0.05; 6 or more come by chance once in a thousand.
    assert!(proposed < 6, "{proposed} of {SEEDS} nulls proposed something");
    assert!(left < 7, "{left} channels of {SEEDS} nulls were left with something");
}

/// Air takes light in proportion to the air mass in every field; clouds lie now on one side of a field and now on the other. What clouds leave on the
/// whole is proposed by the errors of single stars, and withheld since the fields differ.
#[test]
fn clouds_over_parts_of_the_fields_are_no_extinction() {
    let proposed = |mag_per_airmass: &dyn Fn(usize) -> f64, range: &dyn Fn(usize) -> f64| {
        let mut stars = stars(7, nothing);
        for star in &mut stars {
            let off = range(star.frame) * star.image.at[1];
            star.image.airmass = Some(1.6 + off);
            // What the middle of a field loses is in its zero point.
            star.flux_dn *= 10.0_f64.powf(-0.4 * mag_per_airmass(star.frame) * off);
        }
        let judged = judge(&stars, None, FRAMES, &asked(1e-3), &[]).unwrap();
        let own = judged.proposed.iter().find(|own| judged.rows.questions[own.question].id == "extinction");
        own.map(|own| own.against.join("; "))
    };
    assert_eq!(proposed(&|_| 0.2, &|_| 0.5), Some(String::new()));
    // The field that is nearest to the horizon shows it best, by far: it is no outlier.
    assert_eq!(proposed(&|_| 0.9, &|frame| if frame == 4 { 1.5 } else { 0.3 }), Some(String::new()));
    let clouds = proposed(&|frame| 0.1 + 0.2 * (2.4 * frame as f64).sin(), &|_| 0.5).unwrap();
    assert!(clouds.contains("scatters from field to field"), "{clouds}");
}

/// Halves with an amplifier each, upper and lower or left and right, and quarters: the parameters are those that are there.
#[test]
fn halves_are_told_apart() {
    let right: Added = |image| (if image.at[0] > 0.0 { -0.03 } else { 0.0 }, [0.0; 3]);
    let lower: Added = |image| (if image.at[1] > 0.0 { -0.03 } else { 0.0 }, [0.0; 3]);
    let both: Added = |image| ([0, 1].map(|axis| if image.at[axis] > 0.0 { -0.03 } else { 0.0 }).iter().sum(), [0.0; 3]);
    for (added, names) in
        [(right, &["gain_right_relative"][..]), (lower, &["gain_relative"]), (both, &["gain_relative", "gain_right_relative"])]
    {
        for seed in 30..33 {
            let judged = judge(&stars(seed, added), None, FRAMES, &asked(1e-3), &[]).unwrap();
            assert_eq!(found(&judged), ["amplifier-step"], "seed {seed}");
            let own = judged.proposed.iter().find(|own| own.against.is_empty()).unwrap();
            let question = &judged.rows.questions[own.question];
            let told: Vec<&str> = question.parameters.iter().map(|own| own.name).collect();
            assert_eq!(told, names, "seed {seed}");
            for [value, sigma] in &own.sizes {
                // 0.03 mag are 0.0276 of the natural logarithm.
                assert!((value - 0.0276).abs() < 4.0 * sigma && *sigma < 0.006, "seed {seed}: {value} ± {sigma}");
            }
        }
    }
}

/// A loss at the corners that turns its sign in the last third of the frames: it makes these worse, and the colour term is fitted without it.
#[test]
fn what_makes_other_frames_worse_is_in_no_fit() {
    let added: Added = |image| {
        let sign = if image.time_offset_h.unwrap() > 1.0 { -1.0 } else { 1.0 };
        (sign * 0.3 * (image.at[0].powi(2) + image.at[1].powi(2)) - 0.2 * image.colour_offset.unwrap(), [0.0; 3])
    };
    for seed in 120..123 {
        let judged = judge(&stars(seed, added), None, FRAMES, &asked(1e-3), &[]).unwrap();
        let worse = judged.proposed.iter().find(|own| judged.rows.questions[own.question].id == "vignetting").unwrap();
        assert!(worse.held_out.delta_chi2 < 0.0 && !worse.against.is_empty(), "seed {seed}: {worse:?}");
        assert_eq!(found(&judged), ["passband"], "seed {seed}");
        let passband = judged.proposed.iter().find(|own| own.against.is_empty()).unwrap();
        assert_eq!(judged.fit.size.len(), passband.sizes.len(), "seed {seed}: only the colour term is in the fit");
        assert!((passband.sizes[0][0] + 0.2).abs() < 3.0 * passband.sizes[0][1], "seed {seed}: {passband:?}");
    }
}

#[test]
fn what_is_there_is_named_with_its_size() {
    let cases: [(&str, f64, Added); 5] = [
        // Seven tenths of the declared way.
        ("motion-smear", 0.49, |image| {
            let [x, y] = image.trail_px.unwrap();
            (0.0, [x * x, x * y, y * y].map(|product| 0.49 * product / 12.0))
        }),
        ("vignetting", 0.15, |image| (1.0857 * 0.15 * (image.at[0].powi(2) + image.at[1].powi(2)), [0.0; 3])),
        ("passband", -0.2, |image| (-0.2 * image.colour_offset.unwrap(), [0.0; 3])),
        ("axial-colour", 0.05, |image| (0.0, [0.1 * image.colour_offset.unwrap(), 0.0, 0.1 * image.colour_offset.unwrap()])),
        ("brighter-fatter", 0.03, |image| (0.0, [0.06 * image.fullness.unwrap(), 0.0, 0.06 * image.fullness.unwrap()])),
    ];
    for (id, truth, added) in cases {
        let mut pulls = Vec::new();
        for seed in 100..104 {
            let judged = judge(&stars(seed, added), None, FRAMES, &asked(1e-3), &[]).unwrap();
            assert_eq!(found(&judged), [id], "seed {seed}: {:?}", judged.proposed);
            let [value, sigma] = size(&judged, id).unwrap();
            pulls.push((value - truth) / sigma);
        }
        let rms = (pulls.iter().map(|pull| pull * pull).sum::<f64>() / pulls.len() as f64).sqrt();
        assert!((0.2..2.0).contains(&rms), "{id}: pulls {pulls:?}");
    }
}

/// An image that widens towards the corner loses light of the fit there: that is no vignetting.
#[test]
fn a_width_that_follows_the_field_is_no_vignetting() {
    let widening: Added = |image| {
        let radius2 = image.at[0].powi(2) + image.at[1].powi(2);
        (0.03 * radius2, [0.2 * radius2, 0.0, 0.2 * radius2])
    };
    for seed in 200..206 {
        let judged = judge(&stars(seed, widening), None, FRAMES, &asked(1e-3), &[]).unwrap();
        assert_eq!(found(&judged), ["psf-shape"], "seed {seed}");
    }
}

/// A tilt is told as a tilt, a slope in time without its square, and all five parameters of the focal surface where all are there.
#[test]
fn an_effect_is_told_by_no_more_parameters_than_it_needs() {
    const X: &str = "sigma_px_per_half_diagonal_x";
    const Y: &str = "sigma_px_per_half_diagonal_y";
    const SURFACE: [&str; 5] = ["sigma_px_at_corner", X, Y, "astigmatism_at_corner_px2", "sigma_px_at_corner_fourth_order"];
    let cases: [(&str, &[&str], Added); 4] = [
        ("psf-shape", &[X, Y], |image| (0.0, [0.1, 0.0, 0.1].map(|share| share * image.at[0]))),
        ("psf-shape", &SURFACE, |image| {
            let [u, v] = image.at;
            let square = u * u + v * v;
            (0.0, [0.6 * u * u + 0.2 * v + square * square, 0.6 * u * v, 0.6 * v * v + 0.2 * v + square * square])
        }),
        ("focus-drift", &["sigma_px_per_hour"], |image| (0.0, [0.02, 0.0, 0.02].map(|share| share * image.time_offset_h.unwrap()))),
        ("focus-drift", &["sigma_px_per_hour", "sigma_px_per_hour2"], |image| {
            (0.0, [0.03, 0.0, 0.03].map(|share| share * image.time_offset_h.unwrap().powi(2)))
        }),
    ];
    for (id, parameters, added) in cases {
        for seed in 300..303 {
            let judged = judge(&stars(seed, added), None, FRAMES, &asked(1e-3), &[]).unwrap();
            assert_eq!(found(&judged), [id], "seed {seed}, {parameters:?}: {:?}", judged.proposed);
            let own = judged.proposed.iter().find(|own| own.against.is_empty()).unwrap();
            let told: Vec<&str> = judged.rows.questions[own.question].parameters.iter().map(|own| own.name).collect();
            assert_eq!(told, parameters, "seed {seed}: {own:?}");
        }
    }
}

/// The blur of a defocus is its square: a drift over a curved focal surface widens images by the product of both, which no camera that shakes does.
#[test]
fn a_drift_over_a_curved_focal_surface_is_no_jitter() {
    let added: Added = |image| {
        let curved = image.at[0].powi(2) + image.at[1].powi(2);
        let blur = (0.7 * curved + 0.25 * image.time_offset_h.unwrap()).powi(2);
        (0.0, [0.25 * blur, 0.0, 0.25 * blur])
    };
    for seed in 210..214 {
        let judged = judge(&stars(seed, added), None, FRAMES, &asked(1e-3), &[]).unwrap();
        let mut names = found(&judged);
        names.sort_unstable();
        names.dedup();
        assert_eq!(names, ["focus-drift", "psf-shape"], "seed {seed}: {:?}", judged.proposed);
        let questions = judged.proposed.iter().map(|own| &judged.rows.questions[own.question]);
        let told: Vec<&str> = questions.flat_map(|question| question.parameters.iter().map(|own| own.name)).collect();
        assert!(told.contains(&"sigma_px_per_hour_at_corner"), "seed {seed}: {told:?}");
    }
}

/// Rows that stand out by a hundred standard errors are found as those that stand out by ten; and columns where the rows do not.
#[test]
fn lines_that_are_offset_are_banding_however_much() {
    for (variance, which) in [(0.01, 0), (0.5, 0), (0.01, 1)] {
        let frame = |frame: usize| {
            let offset = Estimate { value: variance + 0.001 * (frame as f64 - 5.5) / 3.0, sigma: 0.001 };
            let none = Estimate { value: -0.0005, sigma: 0.001 };
            FrameNoise {
                frame,
                exposure_s: None,
                level_dn: 200.0,
                sigma_dn: 2.6,
                row_variance_dn2: Some(if which == 0 { offset } else { none }),
                column_variance_dn2: Some(if which == 1 { offset } else { none }),
                parity_dn: Some([Estimate { value: 0.001, sigma: 0.002 }; 3]),
                middle_step_dn: None,
            }
        };
        let pixels = PixelStatistics { by_frame: (0..FRAMES).map(frame).collect(), ..PixelStatistics::default() };
        let places = (0..FRAMES).map(|frame| (frame, frame)).collect();
        let detector = DeclaredDetector::default();
        let noise = Some(&Pixels { statistics: &pixels, detector: &detector, places: &places, views: &[] });
        let judged = judge(&stars(3, nothing), noise, FRAMES, &asked(1e-3), &[]).unwrap();
        assert_eq!(found(&judged), ["banding"], "{:?}", judged.proposed);
        let own = &judged.rows.questions[judged.proposed[0].question];
        assert_eq!(own.parameters[0].name, ["row_sigma_dn", "column_sigma_dn"][which]);
        let [value, _] = size(&judged, "banding").unwrap();
        assert!((value / variance - 1.0).abs() < 0.05, "{value} for {variance}");
    }
}

/// The positions show even and odd columns, which are a part of a mosaic of colours: rows and diagonals are no remainder of them. A remainder of a tenth
/// of them may be one.
#[test]
fn a_mosaic_stands_beside_the_even_and_odd_columns_in_it() {
    let of = |parity_dn: [f64; 3]| {
        let frame = |frame: usize| FrameNoise {
            frame,
            exposure_s: None,
            level_dn: 200.0,
            sigma_dn: 2.6,
            row_variance_dn2: None,
            column_variance_dn2: None,
            parity_dn: Some(std::array::from_fn(|which| {
                let noise = ((3 * frame + which) as f64 * 2.399).sin() * 2.0_f64.sqrt();
                Estimate { value: parity_dn[which] + 0.01 * noise, sigma: 0.01 }
            })),
            middle_step_dn: None,
        };
        let pixels = PixelStatistics { by_frame: (0..FRAMES).map(frame).collect(), ..PixelStatistics::default() };
        let places = (0..FRAMES).map(|frame| (frame, frame)).collect();
        let detector = DeclaredDetector::default();
        let noise = Some(&Pixels { statistics: &pixels, detector: &detector, places: &places, views: &[] });
        found(&judge(&stars(3, nothing), noise, FRAMES, &asked(1e-3), &["even-odd".to_owned()]).unwrap())
    };
    assert_eq!(of([2.0, 1.0, 3.0]), ["bayer"]);
    assert_eq!(of([2.0, 0.1, 0.1]), Vec::<&str>::new());
}

/// Columns that are the same in all frames, too weak for one frame: the pairs of frames tell them. What pairs share is nothing without them.
#[test]
fn columns_that_stay_are_told_by_pairs_of_frames() {
    let of = |variance: f64| {
        let noise = |k: usize| (k as f64 * 2.399).sin() * 2.0_f64.sqrt();
        let estimate = |value: f64, sigma: f64, k: usize| Some(Estimate { value: value + sigma * noise(k), sigma });
        let frame = |frame: usize| FrameNoise {
            frame,
            exposure_s: None,
            level_dn: 200.0,
            sigma_dn: 2.6,
            row_variance_dn2: estimate(0.0, 0.001, frame),
            column_variance_dn2: estimate(variance, 0.001, frame + 50),
            parity_dn: None,
            middle_step_dn: None,
        };
        let pairs = (0..FRAMES).flat_map(|one| (one + 1..FRAMES).map(move |other| [one, other]));
        let pair = |(k, frames): (usize, [usize; 2])| LinePair {
            frames,
            rows: estimate(0.0, 0.001, k + 100),
            columns: estimate(variance, 0.001, k + 300),
        };
        let pixels = PixelStatistics {
            by_frame: (0..FRAMES).map(frame).collect(),
            line_pairs: pairs.enumerate().map(pair).collect(),
            ..PixelStatistics::default()
        };
        let places = (0..FRAMES).map(|frame| (frame, frame)).collect();
        let detector = DeclaredDetector::default();
        let noise = Some(&Pixels { statistics: &pixels, detector: &detector, places: &places, views: &[] });
        judge(&stars(3, nothing), noise, FRAMES, &asked(1e-3), &[]).unwrap()
    };
    assert_eq!(found(&of(0.0)), Vec::<&str>::new());
    // Eight tenths of a standard error in a frame.
    let judged = of(0.0008);
    assert_eq!(found(&judged), ["banding"], "{:?}", judged.proposed);
    assert_eq!(judged.rows.questions[judged.proposed[0].question].parameters[0].name, "column_sigma_dn");
    let [value, sigma] = size(&judged, "banding").unwrap();
    assert!((value / 0.0008 - 1.0).abs() < 0.2 && sigma < 0.00015, "{value} ± {sigma}");
}

/// Columns that are offset alike in all frames have a difference of odd and even ones by chance, the same in all: it is no even-odd, however often it is
/// seen. Without such columns it is one.
#[test]
fn columns_that_stay_differ_by_parity_by_chance() {
    const COLUMNS: usize = 400;
    const OFFSET_DN: f64 = 0.2;
    let of = |are_columns_offset: bool| {
        let noise = |k: usize| (k as f64 * 2.399).sin() * 2.0_f64.sqrt();
        let estimate = |value: f64, sigma: f64, k: usize| Estimate { value: value + sigma * noise(k), sigma };
        let variance = if are_columns_offset { OFFSET_DN * OFFSET_DN } else { 0.0 };
        // One and a half times what is usual by chance.
        let parity_dn = 1.5 * OFFSET_DN / (COLUMNS as f64).sqrt();
        let frame = |frame: usize| FrameNoise {
            frame,
            exposure_s: None,
            level_dn: 200.0,
            sigma_dn: 2.6,
            row_variance_dn2: Some(estimate(0.0, 0.001, frame)),
            column_variance_dn2: Some(estimate(variance, 0.001, frame + 50)),
            parity_dn: Some([parity_dn, 0.0, 0.0].map(|value| estimate(value, 0.002, frame))),
            middle_step_dn: None,
        };
        let pairs = (0..FRAMES).flat_map(|one| (one + 1..FRAMES).map(move |other| [one, other]));
        let pair = |(k, frames): (usize, [usize; 2])| LinePair {
            frames,
            rows: Some(estimate(0.0, 0.001, k + 100)),
            columns: Some(estimate(variance, 0.001, k + 300)),
        };
        let sky =
            SkyMesh { frame: 0, exposure_s: None, level_dn: 200.0, noise_dn: 2.6, size_px: [COLUMNS; 2], shape: [0; 2], cells: Vec::new() };
        let pixels = PixelStatistics {
            by_frame: (0..FRAMES).map(frame).collect(),
            line_pairs: pairs.enumerate().map(pair).collect(),
            sky: vec![sky],
            ..PixelStatistics::default()
        };
        let places = (0..FRAMES).map(|frame| (frame, frame)).collect();
        let detector = DeclaredDetector::default();
        let noise = Some(&Pixels { statistics: &pixels, detector: &detector, places: &places, views: &[] });
        judge(&stars(3, nothing), noise, FRAMES, &asked(1e-3), &[]).unwrap()
    };
    assert_eq!(found(&of(true)), ["banding"]);
    assert_eq!(found(&of(false)), ["even-odd"]);
}

/// Seconds and frames are no one unit: where a single exposure is not known the unequal dark current is told per frame.
#[test]
fn unequal_dark_current_is_told_in_the_unit_that_is_known() {
    const UNEQUAL_DN2: f64 = 0.09;
    let of = |are_timed: bool| {
        let noise = |k: usize| (k as f64 * 2.399).sin() * 2.0_f64.sqrt();
        let frame = |frame: usize| FrameNoise {
            frame,
            exposure_s: Some(0.5).filter(|_| are_timed || frame > 0),
            level_dn: 200.0,
            sigma_dn: 2.0,
            row_variance_dn2: None,
            column_variance_dn2: None,
            parity_dn: None,
            middle_step_dn: None,
        };
        let time = if are_timed { 0.5 } else { 1.0 };
        let pairs = (1..FRAMES).flat_map(|one| (one + 1..FRAMES).map(move |other| [one, other]));
        // Of 1 DN a pattern has the root mean square of ½ in units of the noise.
        let pair = |(k, frames): (usize, [usize; 2])| {
            let by_exposure = (0.5_f64 * time).powi(2);
            let covariance = Estimate { value: UNEQUAL_DN2 * by_exposure + 0.001 * noise(k), sigma: 0.001 };
            PatternPair { frames, covariance, by_light: None, by_exposure }
        };
        let fixed_pattern = FixedPattern { pixels: 40_000, pairs: pairs.enumerate().map(pair).collect(), ..FixedPattern::default() };
        let pixels = PixelStatistics { by_frame: (0..FRAMES).map(frame).collect(), fixed_pattern, ..PixelStatistics::default() };
        let places = (0..FRAMES).map(|frame| (frame, frame)).collect();
        let detector = DeclaredDetector::default();
        let noise = Some(&Pixels { statistics: &pixels, detector: &detector, places: &places, views: &[] });
        let judged = judge(&stars(3, nothing), noise, FRAMES, &asked(1e-3), &[]).unwrap();
        assert_eq!(found(&judged), ["dark-current"], "{:?}", judged.proposed);
        let [value, sigma] = size(&judged, "dark-current").unwrap();
        assert!((value - UNEQUAL_DN2).abs() < 4.0 * sigma && sigma < 0.1 * UNEQUAL_DN2, "{value} ± {sigma}");
        judged.rows.questions[judged.proposed[0].question].parameters[0]
    };
    assert_eq!([of(true), of(false)].map(|own| (own.name, own.unit)), [("unequal_dn_per_s", "DN/s"), ("unequal_dn_per_frame", "DN")]);
}
