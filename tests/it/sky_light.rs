//! Light of the sky between the stars: from the models to the pixels.

use boresight::catalog::Catalog;
use boresight::coordinates::PixelPoint;
use boresight::effects::pixel::pixel_effect;
use boresight::effects::sky::glow::SKY_GLOWS;
use boresight::imaging::{Backend, EffectSetting, FrameExposure, ImagingError, PlacedStar, SplitLimits, Stage};
use boresight::recording::{FitsHeaders, write_fits_u16};
use boresight::render::Renderer;
use boresight::scene::Scene;

use crate::twins::{config, cpu, exposure, gpu, sky};

/// A sky with a slope and a hard edge.
fn slope(width: usize, height: usize) -> Vec<f32> {
    let at = |index: usize| if index % width < 5 { 0.0 } else { 10.0 + 0.37 * (index % width) as f32 + 0.11 * (index / width) as f32 };
    (0..width * height).map(at).collect()
}

/// The light of stars comes upon that of the sky, on both sides, in bands and parts as in one piece, and with planes and stages after it.
#[test]
fn the_sky_lies_under_the_stars() {
    for (width, height) in [(120, 90), (61, 83)] {
        let stars = sky(80, width, height, 5);
        let sky_e = slope(width, height);
        let config = config(width, height, vec![EffectSetting::new("veiling_glare", &[("share", 0.05)])]);
        let lit = FrameExposure { sky_e: &sky_e, ..exposure(&stars, 1) };
        let twin = cpu(&config);
        let of_stars = twin.electrons_after(None, &exposure(&stars, 1)).unwrap();
        let on_cpu = twin.electrons_after(None, &lit).unwrap();
        for ((both, stars), sky) in on_cpu.iter().zip(&of_stars).zip(&sky_e) {
            assert!((both - (stars + sky)).abs() <= 1e-5 * both.abs() + 1e-6, "{both} for {stars} + {sky}");
        }
        let dark = twin.electrons_after(None, &FrameExposure { sky_e: &sky_e, ..exposure(&[], 1) }).unwrap();
        assert_eq!(dark, sky_e);
        // Veiling glare spreads the light of the sky with that of the stars and loses none.
        let total = |frame: &[f32]| frame.iter().map(|value| f64::from(*value)).sum::<f64>();
        let veiled = twin.expected_electrons(&FrameExposure { sky_e: &sky_e, ..exposure(&[], 1) }).unwrap();
        assert!((total(&veiled) / total(&sky_e) - 1.0).abs() < 1e-5);
        for limits in [SplitLimits::default(), SplitLimits { entries_per_dispatch: 7, buffer_bytes: 61 * 4 * 16 }] {
            let Some(gpu) = gpu("the_sky_lies_under_the_stars", &config, limits) else { return };
            for stage in [None, Some(Stage::Light)] {
                let (a, b) = (gpu.electrons_after(stage, &lit).unwrap(), twin.electrons_after(stage, &lit).unwrap());
                let brightest = stars.iter().fold(0.0_f64, |most, star| most.max(star.electrons)) as f32;
                assert!(
                    a.iter().zip(&b).all(|(a, b)| (a - b).abs() <= 1e-5 * b.abs() + 1e-7 * brightest),
                    "{width} × {height}, {limits:?}"
                );
            }
            let after = gpu.electrons_after(None, &exposure(&stars, 1)).unwrap();
            assert!(after.iter().zip(&of_stars).all(|(a, b)| (a - b).abs() <= 1e-5 * b.abs() + 0.1), "the sky of another frame shows");
        }
    }
}

#[test]
fn a_sky_of_another_size_is_refused() {
    let imager = cpu(&config(20, 10, vec![]));
    let stars: [PlacedStar; 0] = [];
    for sky_e in [vec![1.0; 199], vec![f32::NAN; 200]] {
        let error = imager.expected_electrons(&FrameExposure { sky_e: &sky_e, ..exposure(&stars, 0) }).unwrap_err();
        assert!(matches!(error, ImagingError::BadSky { expected: 200, .. }), "{error}");
    }
}

/// The middle of the Pacific, where the Moon of 3 March 2026 stands high and full, and new two weeks later.
const SITE: &str = "[site]\nlatitude_deg = 19.8\nlongitude_deg = -155.5\nheight_m = 4200.0\n";

/// A scene with one exposure; `more` is put behind its tables.
fn scene_text(camera: &str, frame: &str, more: &str) -> String {
    format!(
        "format = \"boresight-scene/1\"\n[camera]\n{camera}\n[sky]\nfaintest_magnitude = 2.0\n[detector]\nzero_point_e_per_s = 1e7\n\
         [[frames]]\nexposure_s = 2.0\n{frame}\n{more}"
    )
}

const NARROW: &str = "width_px = 120\nheight_px = 90\nfocal_length_px = 300.0\nk1 = 3e-7";
const FISHEYE: &str = "width_px = 300\nheight_px = 260\nfocal_length_px = 80.0\nprojection = \"equidistant\"";

fn effect(id: &str) -> String {
    format!("[[effects]]\nid = \"{id}\"\n")
}

fn scene(text: &str) -> Scene {
    Scene::parse("test.toml", text).unwrap_or_else(|error| panic!("{error}"))
}

/// Unit vector to the zenith of the only exposure, as right ascension and declination, degrees.
fn zenith_radec_deg(time: &str) -> [f64; 2] {
    let text = scene_text(NARROW, &format!("time_utc = \"{time}\"\nboresight_radec_deg = [0.0, 0.0]"), SITE);
    let [x, y, z] = scene(&text).exposures.get(0).sky.observation().zenith.unwrap();
    [y.atan2(x).to_degrees(), z.asin().to_degrees()]
}

/// A view of the zenith.
fn zenith_scene(camera: &str, time: &str, effects: &str) -> Scene {
    let [ra, dec] = zenith_radec_deg(time);
    let frame = format!("time_utc = \"{time}\"\nboresight_radec_deg = [{ra}, {dec}]");
    scene(&scene_text(camera, &frame, &format!("{SITE}{effects}")))
}

fn mean(frame: &[f32]) -> f64 {
    frame.iter().map(|value| f64::from(*value)).sum::<f64>() / frame.len() as f64
}

const FULL_MOON: &str = "2026-03-03T10:30:00Z";
const NEW_MOON: &str = "2026-03-19T10:30:00Z";
const DUSK: &str = "2026-03-19T05:15:00Z";

/// Every pixel is within half a per cent of the model evaluated for it, under a narrow lens as under one that sees more than the sky; beyond the horizon
/// there is nothing. With nothing but the air's glow the middle of a view of the zenith has what the magnitude says.
#[test]
fn pixels_hold_what_the_models_say() {
    let all: String = ["zodiacal-light", "starlight", "airglow", "moonlight", "twilight"].map(effect).concat();
    for camera in [NARROW, FISHEYE] {
        let scene = zenith_scene(camera, FULL_MOON, &all);
        let (width, frame) = (scene.camera.width_px, scene.sky_light_e(0));
        let mut lit = 0;
        for (index, found) in frame.iter().enumerate() {
            let place = PixelPoint { x_px: (index % width) as f64, y_px: (index / width) as f64 };
            let exact = scene.sky_light_at_e(0, place);
            assert!((f64::from(*found) - exact).abs() <= 0.005 * exact + 1e-4, "{found} for {exact} at {place:?} of {width}");
            lit += usize::from(exact > 0.0);
        }
        if camera == FISHEYE {
            // The circle of the horizon has the radius f·π/2.
            let circle = std::f64::consts::PI * (80.0 * std::f64::consts::FRAC_PI_2).powi(2);
            assert!((lit as f64 / circle - 1.0).abs() < 0.01, "{lit} pixels lit for {circle}");
        } else {
            assert_eq!(lit, frame.len());
        }
    }
    let scene = zenith_scene(NARROW, NEW_MOON, "[[effects]]\nid = \"airglow\"\nparameters = { zenith_mag_arcsec2 = 21.5 }\n");
    let frame = scene.sky_light_e(0);
    let middle = f64::from(frame[45 * 120 + 60]);
    let pixel_arcsec = 206_264.806_247 / 300.0;
    let expected = 10.0_f64.powf(-0.4 * 21.5) * pixel_arcsec * pixel_arcsec * 1e7 * 2.0;
    assert!((middle / expected - 1.0).abs() < 1e-3, "{middle} for {expected}");
}

/// What is rendered without noise is the sum of models and stars, on both sides; what is off is not there.
#[test]
fn a_rendered_frame_has_the_light_of_the_sky() {
    let catalog = Catalog::embedded();
    let lit = zenith_scene(NARROW, FULL_MOON, &effect("moonlight"));
    let dark = zenith_scene(NARROW, FULL_MOON, "");
    let of = |scene: &Scene, backend| Renderer::new(scene, catalog, backend).unwrap().expected_electrons(0).unwrap();
    let (with, without) = (of(&lit, Backend::Cpu), of(&dark, Backend::Cpu));
    // Without models there are the usual 50 electrons a second; with them there is no even background that nobody asked for.
    let (sky, even) = (mean(&lit.sky_light_e(0)), 2.0 * 50.0);
    assert!((mean(&with) - (mean(&without) - even + sky)).abs() < 1e-3 * sky, "{} {} {sky}", mean(&with), mean(&without));
    assert!(dark.sky_light_e(0).is_empty());
    let off = zenith_scene(NARROW, FULL_MOON, "[[effects]]\nid = \"moonlight\"\nparameters = { relative = 0.0 }\n");
    assert!(off.sky_light_e(0).iter().all(|electrons| *electrons == 0.0));
    if let Some(on_gpu) = gpu("a_rendered_frame_has_the_light_of_the_sky", &config(16, 16, vec![]), SplitLimits::default()) {
        drop(on_gpu);
        let on_gpu = of(&lit, Backend::Gpu);
        assert!(on_gpu.iter().zip(&with).all(|(a, b)| (a - b).abs() <= 1e-5 * b.abs() + 1e-2));
    }
}

/// A full Moon makes the night more than ten times as bright as a new one; dusk is brightest towards the Sun.
#[test]
fn moon_and_sun_light_the_sky_they_stand_in() {
    let night = |time| mean(&zenith_scene(NARROW, time, &(effect("moonlight") + &effect("airglow"))).sky_light_e(0));
    assert!(night(FULL_MOON) > 10.0 * night(NEW_MOON), "{} {}", night(FULL_MOON), night(NEW_MOON));

    let scene = zenith_scene(FISHEYE, DUSK, &effect("twilight"));
    let exposure = scene.exposures.get(0);
    let observation = exposure.sky.observation();
    let sun = boresight::coordinates::Direction::along(observation.sun_au.unwrap().map(|component| -component));
    let sun = scene.exposures.get(0).attitude.camera_from_apparent(&sun).xyz;
    let frame = scene.sky_light_e(0);
    let (mut x, mut y, mut sum) = (0.0, 0.0, 0.0);
    for (index, electrons) in frame.iter().enumerate() {
        let (dx, dy) = ((index % 300) as f64 - 149.5, (index / 300) as f64 - 129.5);
        if dx.hypot(dy) < 125.0 {
            x += f64::from(*electrons) * dx;
            y += f64::from(*electrons) * dy;
            sum += f64::from(*electrons);
        }
    }
    let apart_deg = (y.atan2(x) - sun[1].atan2(sun[0])).sin().asin().to_degrees().abs();
    assert!(apart_deg < 2.0 && (x * sun[0] + y * sun[1]) > 0.0 && x.hypot(y) / sum > 5.0, "{apart_deg}° {x} {y} {sum}");
}

/// A star that a bright sky covers has less signal over its noise, and the truth knows where.
#[test]
fn the_truth_knows_the_sky_behind_each_star() {
    let catalog = Catalog::embedded();
    let [ra, dec] = zenith_radec_deg(FULL_MOON);
    let stars = |effects: &str| {
        let frame = format!("time_utc = \"{FULL_MOON}\"\nboresight_radec_deg = [{ra}, {dec}]");
        let text = scene_text(NARROW, &frame, &format!("{SITE}{effects}")).replace("faintest_magnitude = 2.0", "faintest_magnitude = 6.0");
        Renderer::new(&scene(&text), catalog, Backend::Cpu).unwrap().render(0).unwrap().stars
    };
    let (dark, moonlit) = (stars("[[effects]]\nid = \"moonlight\"\nparameters = { relative = 0.0 }\n"), stars(&effect("moonlight")));
    assert!(!dark.is_empty() && dark.len() == moonlit.len());
    for (dark, moonlit) in dark.iter().zip(&moonlit) {
        assert!(dark.hip == moonlit.hip && moonlit.snr < dark.snr, "{} {}", dark.snr, moonlit.snr);
    }
}

/// An image of the size of the frame is a background; one of another size, one that is negative or not there is refused in a sentence.
#[test]
fn an_image_can_be_the_background() {
    let folder = tempfile::tempdir().unwrap();
    let counts: Vec<u16> = (0..120 * 90).map(|index| 100 + (index % 120) as u16).collect();
    let headers = FitsHeaders::default();
    write_fits_u16(&folder.path().join("sky.fits"), 120, 90, &counts, &headers).unwrap();
    write_fits_u16(&folder.path().join("small.fits"), 60, 90, &counts[..5400], &headers).unwrap();
    let open = |sky: &str| {
        let text = scene_text(NARROW, "boresight_radec_deg = [10.0, 20.0]", "").replace("faintest_magnitude = 2.0", sky);
        std::fs::write(folder.path().join("scene.toml"), text).unwrap();
        Scene::open(&folder.path().join("scene.toml"))
    };
    let scene = open("background_image = \"sky.fits\"\nbackground_image_scale = 0.5").unwrap();
    let frame = scene.sky_light_e(0);
    assert!(frame.iter().zip(&counts).all(|(electrons, count)| *electrons == f32::from(*count) * 0.5 * 2.0));
    assert_eq!(scene.sky.even_e_per_px_s(), 0.0);
    for (sky, words) in [
        ("background_image = \"small.fits\"", "60 × 90 px, but the frame 120 × 90"),
        ("background_image = \"none.fits\"", "none.fits"),
        ("background_image_scale = -1.0", "sky.background_image_scale"),
        ("background_imag = \"sky.fits\"", "did you mean background_image?"),
    ] {
        let error = open(sky).unwrap_err().to_string();
        assert!(error.contains(words) && !error.contains('\n'), "{error}");
    }
}

#[test]
fn what_a_light_of_the_sky_lacks_is_said() {
    let frame = "boresight_radec_deg = [10.0, 20.0]";
    let timed = "boresight_radec_deg = [10.0, 20.0]\ntime_utc = \"2026-03-03T10:30:00Z\"";
    for (frame, more, words) in [
        (frame, effect("zodiacal-light"), "effects[0]: zodiacal-light needs the time of every exposure, and exposure 0 lacks it"),
        (timed, effect("moonlight"), "moonlight needs a [site] and the time"),
        (timed, effect("moonligt"), "did you mean moonlight?"),
        (timed, effect("starlight") + &effect("starlight"), "listed twice"),
        (timed, effect("starlight") + "parameters = { relativ = 1.0 }\n", "starlight has no parameter relativ; it has relative"),
        (timed, effect("starlight") + "parameters = { relative = -1.0 }\n", "must lie between 0 and 1000"),
    ] {
        let error = Scene::parse("test.toml", &scene_text(NARROW, frame, &more)).unwrap_err().to_string();
        assert!(error.contains(words) && error.starts_with("test.toml: "), "{error}");
    }
    assert!(Scene::parse("test.toml", &scene_text(NARROW, timed, &effect("zodiacal_light"))).is_ok());
    assert!(Scene::parse("test.toml", &scene_text(NARROW, frame, &effect("starlight"))).is_ok());
}

/// Ids, files and pages of the sources, and their place in the schema.
#[test]
fn every_light_of_the_sky_has_its_file_and_its_page() {
    let schema = boresight::scene::schema().to_string();
    for glow in SKY_GLOWS {
        let (id, source) = (glow.id(), glow.source());
        let file = crate::house::root().join(format!("src/effects/sky/{}.rs", id.replace('-', "_")));
        assert!(std::fs::read_to_string(file).unwrap().starts_with(source) && source.starts_with("//!"), "{id} shows the page of another");
        assert!(boresight::effects::displacement(id).is_none() && pixel_effect(&id.replace('-', "_")).is_none(), "{id} is another's id");
        assert!(schema.contains(&format!("\"{id}\"")));
        let page = boresight::effects::page_of(source);
        crate::common::check_page(id, &page);
        for parameter in glow.parameters() {
            assert!(page.contains(&format!("`{}`", parameter.name)), "the page of {id} is silent about {}", parameter.name);
        }
    }
}
