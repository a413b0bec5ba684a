//! The diagnosis's claims are statistics: p-values where there is nothing, sizes with errors where there is something.

use boresight::calibrate::trial::Trial;
use boresight::catalog::Catalog;
use boresight::coordinates::Direction;
use boresight::diagnose::{DiagnoseOptions, Diagnosis, EffectState, Verdict, diagnose};
use boresight::effects::StarState;
use boresight::identify::{ControlPoint, ControlPoints, handedness};
use rand::SeedableRng;
use rand_distr::{Distribution, Normal};
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;

/// A night of 20 frames of the published camera at 0.1 px, with what `displace` adds to each measured point: (colour offset, x and y from
/// the middle in px) → px.
fn night(seed: u64, displace: impl Fn(f64, [f64; 2]) -> [f64; 2]) -> ControlPoints {
    let trial = Trial { frames: 20, ..Trial::published() };
    let mut points = trial.night(Catalog::embedded(), seed).control_points;
    for point in &mut points.points {
        let colour = point.colour.map_or(0.0, |colour| colour - StarState::REFERENCE_COLOUR);
        let [dx, dy] = displace(colour, [point.x_px - 511.5, point.y_px - 511.5]);
        point.x_px += dx;
        point.y_px += dy;
    }
    points
}

fn diagnosed(points: &ControlPoints, seed: u64) -> Diagnosis {
    diagnose(points, &Vec::new(), &DiagnoseOptions { nulls: 200, seed, ..DiagnoseOptions::default() }).unwrap()
}

/// Where nothing is missing nothing is named, and the p-values are no smaller than those of chance.
#[test]
fn nothing_is_found_where_nothing_is_missing() {
    const NIGHTS: u64 = 60;
    let found: Vec<Diagnosis> = (0..NIGHTS).into_par_iter().map(|seed| diagnosed(&night(900 + seed, |_, _| [0.0; 2]), seed)).collect();
    assert!(found.iter().all(|diagnosis| diagnosis.verdict == Verdict::Consistent && diagnosis.findings.is_empty()));
    let p: Vec<f64> = found.iter().map(|diagnosis| diagnosis.channels.astrometry.p_value.unwrap()).collect();
    for (limit, most) in [(0.02, 6), (0.1, 15), (0.3, 33)] {
        // Binomial of 60: chance exceeds these counts with less than 1e-3.
        let below = p.iter().filter(|p| **p < limit).count();
        assert!(below <= most, "{below} of {NIGHTS} below {limit}");
    }
    assert!(p.iter().filter(|p| **p < 0.6).count() >= 10, "p-values that are always large are no test: {p:?}");
}

/// A lateral colour is named, located and measured, with an error that is its scatter over nights.
#[test]
fn a_colour_that_scales_is_named_and_measured() {
    const NIGHTS: u64 = 16;
    const SCALE: f64 = 4e-4;
    let found: Vec<Diagnosis> = (0..NIGHTS)
        .into_par_iter()
        .map(|seed| diagnosed(&night(300 + seed, |colour, [x, y]| [SCALE * colour * x, SCALE * colour * y]), seed))
        .collect();
    let mut square = 0.0;
    for (seed, diagnosis) in found.iter().enumerate() {
        let ids: Vec<&str> = diagnosis.findings.iter().map(|finding| finding.id.as_str()).collect();
        assert_eq!((diagnosis.verdict, ids.as_slice()), (Verdict::Explained, ["lateral-colour"].as_slice()), "night {seed}");
        let finding = &diagnosis.findings[0];
        assert_eq!(finding.located_by[0], "colour");
        assert!(finding.held_out_delta_chi2 > 0.0 && diagnosis.fit.after.rms_px < diagnosis.fit.baseline.rms_px);
        square += ((finding.parameters[0].value - SCALE) / finding.parameters[0].sigma).powi(2);
    }
    let pulls = (square / NIGHTS as f64).sqrt();
    // χ² of 16: 0.53 … 1.55 with 99.9 %.
    assert!((0.53..1.55).contains(&pulls), "{pulls}");
}

/// What attitudes take up is not claimed, and what the recording lacks is said.
#[test]
fn what_cannot_be_seen_is_said() {
    let diagnosis = diagnosed(&night(77, |_, _| [0.3, -0.2]), 1);
    let state = |id: &str| diagnosis.effects.iter().find(|effect| effect.id == id).unwrap();
    assert_eq!(diagnosis.verdict, Verdict::Consistent, "a shift of the whole image is an attitude");
    assert_eq!(state("frame-rotation").status, EffectState::NotObservable);
    for id in ["thermal-focal-length", "rolling-shutter", "parallax"] {
        assert_eq!(state(id).status, EffectState::NotApplicable, "{id}");
        assert!(!state(id).reason.is_empty());
    }
    let limit = state("pixel-aspect").upper_limit_95.as_ref().unwrap();
    assert!(limit.value > 0.0 && limit.value < 1e-3, "{limit:?}");
}

/// The same recording and seed give the same diagnosis, whatever the number of threads.
#[test]
fn a_diagnosis_is_reproducible() {
    let points = night(5, |_, [x, y]| [2e-4 * x, -2e-4 * y]);
    let of = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let mut diagnosis = pool.install(|| diagnosed(&points, 9));
        diagnosis.seconds = 0.0;
        serde_json::to_string(&diagnosis).unwrap()
    };
    assert_eq!(of(1), of(3));
}

/// One field looked at `frames` times, each with noise of its own.
fn still(seed: u64, frames: usize, displace: impl Fn(usize, u32, [f64; 2]) -> [f64; 2]) -> ControlPoints {
    let night = Trial { frames: 1, stars_per_frame: 30, noise_px: 0.0, ..Trial::published() }.night(Catalog::embedded(), seed);
    let first = night.control_points;
    let noise = Normal::new(0.0, 0.1).unwrap();
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    let mut points = Vec::new();
    for frame in 0..frames {
        for point in &first.points {
            let [dx, dy] = displace(frame, point.hip, [point.x_px - 511.5, point.y_px - 511.5]);
            let (x_px, y_px) = (point.x_px + dx + noise.sample(&mut rng), point.y_px + dy + noise.sample(&mut rng));
            points.push(ControlPoint { frame, x_px, y_px, covariance_px2: [0.01, 0.0, 0.01], ..*point });
        }
    }
    ControlPoints::new(first.nominal, vec![first.attitudes[0]; frames], points)
}

/// Whatever its size, a frame of another scale is seen: what is large and hangs together is not taken for heavy tails.
#[test]
fn one_frame_out_of_line_is_seen_however_far_out() {
    for scale in [1e-3, 3e-3, 1e-2] {
        let mut points = night(41, |_, _| [0.0; 2]);
        for point in points.points.iter_mut().filter(|point| point.frame == 7) {
            point.x_px += scale * (point.x_px - 511.5);
            point.y_px += scale * (point.y_px - 511.5);
        }
        let diagnosis = diagnosed(&points, 1);
        let unknown = diagnosis.unknown.first().unwrap_or_else(|| panic!("{scale}: {:?}", diagnosis.verdict));
        assert_eq!((diagnosis.verdict, unknown.located_by[0].as_str()), (Verdict::Unexplained, "frame"), "{scale}");
    }
}

/// A star beside its catalogue place is told by name, not by an effect that its images happen to follow.
#[test]
fn one_star_out_of_place_is_seen() {
    let hip = still(5, 1, |_, _, _| [0.0; 2]).points[11].hip;
    for off_px in [0.3, 3.0] {
        let points = still(5, 14, |_, own, _| if own == hip { [off_px, -0.5 * off_px] } else { [0.0; 2] });
        let diagnosis = diagnosed(&points, 1);
        let unknown = diagnosis.unknown.first().unwrap_or_else(|| panic!("{off_px} px: {:?}", diagnosis.verdict));
        assert!(unknown.located_by.iter().any(|name| name == "star"), "{off_px} px: {:?}", unknown.located_by);
        assert!(diagnosis.findings.is_empty(), "{off_px} px: {:?}", diagnosis.findings);
    }
}

/// A camera that always looks at one field has the same stars at the same places: columns that hold errors of the measured points would
/// explain the residuals with them.
#[test]
fn one_field_again_and_again_is_no_trap() {
    for seed in 0..6 {
        let null = diagnosed(&still(60 + seed, 14, |_, _, _| [0.0; 2]), seed);
        assert_eq!(null.verdict, Verdict::Consistent, "{seed}");
        let aspect = diagnosed(&still(80 + seed, 14, |_, _, [x, y]| [2e-4 * x, -2e-4 * y]), seed);
        let ids: Vec<&str> = aspect.findings.iter().map(|finding| finding.id.as_str()).collect();
        assert_eq!((aspect.verdict, ids.as_slice()), (Verdict::Explained, ["pixel-aspect"].as_slice()), "{seed}: {:?}", aspect.summary);
    }
}

/// The S-curve depends on where the star truly stands within its pixel: its amplitude comes back in full though only noisy places are known.
#[test]
fn noise_does_not_make_an_s_curve_smaller() {
    const NIGHTS: u64 = 8;
    const AMPLITUDE: f64 = 0.08;
    let pulls: Vec<f64> = (0..NIGHTS)
        .into_par_iter()
        .flat_map_iter(|seed| {
            let night = Trial { frames: 20, ..Trial::published() }.night(Catalog::embedded(), 500 + seed);
            let mut points = night.control_points;
            for point in &mut points.points {
                let direction = night.attitudes[point.frame].camera_from_icrs * nalgebra::Vector3::from(point.direction.xyz);
                let truth = night.truth.pixel(&Direction::from_unit(direction.into())).unwrap();
                let moved = |place: f64| {
                    let landed = (0..60).fold(place, |at, _| place + AMPLITUDE * (std::f64::consts::TAU * at).sin());
                    landed - place
                };
                point.x_px += moved(truth.x_px);
                point.y_px += moved(truth.y_px);
            }
            let diagnosis = diagnosed(&points, seed);
            assert_eq!(diagnosis.findings.len(), 1, "{:?}", diagnosis.summary);
            assert_eq!(diagnosis.findings[0].id, "s-curve");
            let parameters = diagnosis.findings[0].parameters.clone();
            parameters.into_iter().map(|parameter| (parameter.value - AMPLITUDE) / parameter.sigma)
        })
        .collect();
    let mean = pulls.iter().sum::<f64>() / pulls.len() as f64;
    // 16 of them: the mean has a standard error of a quarter. Taken at the measured places it would be less than −2.
    assert!(mean.abs() < 1.0, "{mean}: {pulls:?}");
}

/// Whether a list's images are mirrored is seen from its own identifications.
#[test]
fn a_mirrored_list_is_recognised() {
    let mut points = night(3, |_, _| [0.0; 2]);
    assert_eq!(handedness(&points), 1);
    for point in &mut points.points {
        point.x_px = 1023.0 - point.x_px;
    }
    assert_eq!(handedness(&points), -1);
}

/// A covariate of the frames is dealt out among the frames, one of the stars among the images of each frame; and neither is as closely followed
/// once dealt out.
#[test]
fn covariates_are_dealt_out_as_they_are_exchangeable() {
    let focus = |frame: usize| ((frame * 7919) % 20) as f64 / 20.0 - 0.475;
    let mut points = night(61, |_, _| [0.0; 2]);
    for point in &mut points.points {
        point.x_px += 6e-4 * focus(point.frame) * (point.x_px - 511.5);
        point.y_px += 6e-4 * focus(point.frame) * (point.y_px - 511.5);
    }
    let telemetry = (0..20).map(|frame| [("focus".to_owned(), focus(frame))].into_iter().collect()).collect();
    let options = DiagnoseOptions { nulls: 200, seed: 1, ..DiagnoseOptions::default() };
    let diagnosis = diagnose(&points, &telemetry, &options).unwrap();
    let first = &diagnosis.located[0];
    assert_eq!((first.covariate.as_str(), first.permuted.as_deref()), ("focus", Some("frames")));
    assert!(first.permutation_p_value.unwrap() < 0.01, "{first:?}");
    let colours = diagnosed(&night(301, |colour, [x, y]| [4e-4 * colour * x, 4e-4 * colour * y]), 1);
    let first = &colours.located[0];
    assert_eq!((first.covariate.as_str(), first.permuted.as_deref()), ("colour", Some("star images within their frames")));
    assert!(first.permutation_p_value.unwrap() < 0.01, "{first:?}");
}

/// Errors that the images of a frame share are no effect, however much of the residuals they make up; and one that all frames have is agreed on
/// by their signs, chosen again without each frame, and there when the recording is simulated anew.
#[test]
fn frames_have_to_agree() {
    const NIGHTS: u64 = 12;
    let named: Vec<String> = (0..NIGHTS)
        .into_par_iter()
        .flat_map_iter(|seed| {
            let mut rng = Pcg64Mcg::seed_from_u64(seed);
            let own: Vec<[f64; 2]> = (0..20).map(|_| [0, 1].map(|_| Normal::new(0.0, 4e-4).unwrap().sample(&mut rng))).collect();
            let mut points = night(500 + seed, |_, _| [0.0; 2]);
            for point in &mut points.points {
                let [a, b] = own[point.frame];
                let (x, y) = (point.x_px - 511.5, point.y_px - 511.5);
                point.x_px += a * x + b * y;
                point.y_px += b * x - a * y;
            }
            diagnosed(&points, seed).findings.into_iter().map(|finding| finding.id)
        })
        .collect();
    assert!(named.is_empty(), "{named:?}");
    let found: Vec<(usize, Diagnosis)> = [8, 20]
        .into_par_iter()
        .flat_map_iter(|frames| {
            (0..8).map(move |seed| (frames, diagnosed(&still(20 + seed, frames, |_, _, [x, y]| [3e-4 * x, -3e-4 * y]), seed)))
        })
        .collect();
    let (mut differs, mut ahead) = ([0; 2], 0.0);
    for (frames, diagnosis) in &found {
        let finding = diagnosis.findings.iter().find(|finding| finding.id == "pixel-aspect").unwrap_or_else(|| panic!("{frames} frames"));
        assert!(finding.signs.p_value.unwrap() < 1e-3 && finding.signs.effective > 10.0, "{:?}", finding.signs);
        let turns = finding.chosen_again;
        assert!(turns[1] == 8 && turns[0] >= 7, "{frames} frames: {turns:?}");
        assert_eq!(finding.left_out, if *frames == 8 { "frames" } else { "blocks of frames" });
        // Of single recordings a rival may have the luck.
        ahead += finding.rivals.iter().filter_map(|rival| Some(finding.held_out_delta_chi2 - rival.held_out_delta_chi2?)).sum::<f64>();
        for (differs, p) in differs.iter_mut().zip([finding.resimulated_p_value, diagnosis.resimulated_p_value]) {
            *differs += usize::from(p.unwrap() < 0.05);
        }
    }
    // Binomial of 16: five below 0.05 with less than 1e-3.
    assert!(differs.into_iter().all(|differs| differs < 5), "{differs:?}");
    assert!(ahead > 100.0, "rivals in its place do as well on frames not used: {ahead}");
}

/// The slope of what a profile draws on the model that it draws, and the slope's standard error.
fn drawn_slope(profile: &boresight::diagnose::Profile) -> [f64; 2] {
    let sum = |of: &dyn Fn(&boresight::diagnose::ProfileBin) -> f64| {
        profile.bins.iter().map(|bin| of(bin) / (bin.sigma * bin.sigma)).sum::<f64>()
    };
    let square = sum(&|bin| bin.model * bin.model);
    [sum(&|bin| bin.mean * bin.model) / square, 1.0 / square.sqrt()]
}

/// What is drawn of a finding is the data that tell its size, and no more: a line through the points has the slope one, with the finding's own
/// relative error; and the points scatter about it as their errors say.
#[test]
fn a_profile_tells_the_size_as_well_as_the_finding() {
    let lateral = |colour: f64, [x, y]: [f64; 2]| [4e-4 * colour * x, 4e-4 * colour * y];
    let aspect = |_: f64, [x, y]: [f64; 2]| [2e-4 * x, -2e-4 * y];
    let wave = |_: f64, [x, y]: [f64; 2]| [x, y].map(|at| 0.08 * (std::f64::consts::TAU * (at + 511.5)).sin());
    let nights: Vec<(&str, ControlPoints)> = (0..4)
        .flat_map(|seed| {
            [
                ("lateral-colour", night(310 + seed, lateral)),
                ("pixel-aspect", night(320 + seed, aspect)),
                ("s-curve", night(330 + seed, wave)),
            ]
        })
        .collect();
    let drawn: Vec<(&str, Diagnosis)> = nights.into_par_iter().map(|(id, points)| (id, diagnosed(&points, 1))).collect();
    let (mut chi2, mut bins) = (0.0, 0.0);
    for (id, diagnosis) in &drawn {
        let profile =
            diagnosis.profiles.iter().find(|profile| profile.id == *id).unwrap_or_else(|| panic!("{id}: {:?}", diagnosis.summary));
        let [slope, error] = drawn_slope(profile);
        let finding = diagnosis.findings.iter().find(|finding| finding.id == *id).unwrap();
        let own = finding.parameters.iter().find(|parameter| parameter.name == profile.parameter.name).unwrap();
        let page = own.sigma / own.value.abs();
        assert!((error / page - 1.0).abs() < 0.1, "{id}: the slope's error is {error}, the page's {page}");
        assert!((slope - 1.0).abs() < 0.1 * error, "{id}: {slope} ± {error}");
        assert!(profile.bins.iter().map(|bin| bin.stars).sum::<usize>() * 10 > diagnosis.stars_used.with_proper_motion * 9, "{id}");
        for bin in &profile.bins {
            chi2 += ((bin.mean - bin.model) / bin.sigma).powi(2);
            bins += 1.0;
        }
    }
    // One of each profile's twelve bins is taken by the size; χ² of some 130: 0.6 … 1.45 with 99.9 %.
    let scatter = chi2 / (bins - drawn.len() as f64);
    assert!((0.6..1.45).contains(&scatter), "{scatter}");
    let covariate = |id: &str| &drawn.iter().find(|(own, _)| *own == id).unwrap().1.profiles[0].covariate;
    assert_eq!(
        (covariate("lateral-colour").as_str(), covariate("s-curve").as_str()[..11].to_owned()),
        ("colour", "pixel-phase".to_owned())
    );
}

/// A handful of stars could show no effect of ordinary size: nothing is decided, and what could have been seen is said.
#[test]
fn with_a_handful_of_stars_nothing_is_decided() {
    let trial = Trial { frames: 2, stars_per_frame: 18, noise_px: 0.6, ..Trial::published() };
    let points = trial.night(Catalog::embedded(), 12).control_points;
    let diagnosis = diagnosed(&points, 1);
    let places = &diagnosis.channels.astrometry;
    assert_eq!(diagnosis.verdict, Verdict::Undecided, "{:?}", diagnosis.summary);
    assert!(
        diagnosis.summary[0].starts_with("positions: undecided; ") && diagnosis.summary[0].ends_with("not looked at"),
        "{:?}",
        diagnosis.summary
    );
    assert!(places.detectable.iter().all(|own| !own.would_show && !own.source.is_empty()) && places.detectable.len() > 10);
    let seen = places.detectable.iter().find_map(|own| own.size_95.map(|size| (size, own.ordinary))).unwrap();
    assert!(seen.0 > seen.1 && diagnosis.summary[1].contains("what could have been seen"), "{:?}", diagnosis.summary[1]);
    // Twenty frames of more and better stars could have shown something.
    let many = diagnosed(&night(903, |_, _| [0.0; 2]), 1);
    assert_eq!(many.verdict, Verdict::Consistent);
    assert!(many.channels.astrometry.detectable.iter().any(|own| own.would_show), "{:?}", many.channels.astrometry.detectable);
}

/// The size that would have been found is one that is found: of recordings with an effect of that size nearly all are seen to have it.
#[test]
fn what_could_be_detected_is_detected() {
    const NIGHTS: u64 = 12;
    let power = diagnosed(&night(940, |_, _| [0.0; 2]), 1).channels.astrometry.detectable;
    let size = power.iter().find(|own| own.id == "pixel-aspect").and_then(|own| own.size_95).unwrap();
    let verdicts: Vec<Verdict> = (0..NIGHTS)
        .into_par_iter()
        .map(|seed| diagnosed(&night(940 + seed, |_, [x, y]| [0.5 * size * x, -0.5 * size * y]), 1).verdict)
        .collect();
    let seen = verdicts.iter().filter(|verdict| **verdict != Verdict::Consistent).count();
    assert!(seen + 3 > NIGHTS as usize, "{seen} of {NIGHTS} at {size}");
}
