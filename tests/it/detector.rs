//! The detector of a scene: bits, colours, and what is refused of them.

use boresight::catalog::Catalog;
use boresight::imaging::Backend;
use boresight::render::{Rendered, Renderer};
use boresight::scene::{DEMO_TOML, Scene};

/// A small frame of Orion by the demo's camera; `detector` stands in its `[detector]`, `more` at its end.
pub(crate) fn small_scene(detector: &str, more: &str) -> String {
    let start = DEMO_TOML.find("[site]").expect("the demo has a site");
    let camera = DEMO_TOML[..start].replace("width_px = 1024", "width_px = 96").replace("height_px = 1024", "height_px = 80");
    let camera = camera.replace("principal_point_px = [518.3, 506.1]", "").replace("saturation_dn = 65535.0", detector);
    format!("{camera}\n[[frames]]\nboresight_radec_deg = [83.0, -1.0]\nexposure_s = 0.1\n{more}")
}

pub(crate) fn parse(detector: &str, more: &str) -> Scene {
    Scene::parse("scene.toml", &small_scene(detector, more)).unwrap()
}

fn rendered(scene: &Scene) -> Rendered {
    Renderer::new(scene, Catalog::embedded(), Backend::Cpu).unwrap().render(0).unwrap()
}

#[test]
fn bad_detectors_get_one_clear_sentence() {
    let table = |lines: &str| format!("[detector.quantum_efficiency]\n{lines}");
    let filters = |lines: &str| format!("[detector.colour_filters]\n{lines}");
    let curve = "wavelengths_nm = [400.0, 700.0]\nvalues = [0.5, 0.5]";
    for (detector, more, parts) in [
        ("bits = 17", String::new(), &["detector.bits = 17", "between 8 and 16"][..]),
        ("bits = 12\nsaturation_dn = 4096.0", String::new(), &["detector.saturation_dn = 4096", "2^bits - 1"][..]),
        ("bits = 8\nbias_dn = 300.0", String::new(), &["duplicate key"][..]),
        ("saturation_dn = 65536.0", String::new(), &["detector.saturation_dn = 65536", "65535"][..]),
        ("saturation_dn = nan", String::new(), &["detector.saturation_dn = NaN"][..]),
        (
            "bits = 10",
            "[[effects]]\nid = \"adc\"\nparameters = { saturation_dn = 1024.0 }".to_owned(),
            &["effects[0]", "adc.saturation_dn = 1024 lies beyond 1023, the end of 10 bits"][..],
        ),
        ("colour_term_mag_per_mag = 3.0", String::new(), &["colour_term_mag_per_mag = 3", "between -2 and 2"][..]),
        ("colour_term_mag_per_mag = 0.1", table(curve), &["colour_term_mag_per_mag = given", "keep one of the two"][..]),
        ("", table("wavelengths_nm = [700.0, 400.0]\nvalues = [0.5, 0.5]"), &["quantum_efficiency.wavelengths_nm", "increasing"][..]),
        ("", table("wavelengths_nm = [400.0, 700.0]\nvalues = [0.5]"), &["quantum_efficiency.values = 1 numbers"][..]),
        ("", table(&format!("{curve}\ntransmission = [0.5, 1.5]")), &["quantum_efficiency.transmission = 1.5", "0 and 1"][..]),
        ("", table("wavelengths_nm = [400.0, 700.0]\nvalues = [0.0, 0.0]"), &["quantum_efficiency.values", "some light"][..]),
        ("", filters("relative_per_mag = 2.0"), &["colour_filters.relative_per_mag = 2", "between -1 and 1"][..]),
        ("", filters("relative_per_mag = 0.2\nred = [1.0]"), &["colour_filters.relative_per_mag", "keep one of the two"][..]),
        ("", filters("wavelengths_nm = [400.0, 700.0]\nred = [0.5, 0.5]"), &["colour_filters.green = 0 numbers"][..]),
        (
            "",
            filters("wavelengths_nm = [400.0, 700.0]\nred = [0.5, 0.5]\ngreen = [0.0, 0.0]\nblue = [0.5, 0.5]"),
            &["colour_filters.green", "a tenth"][..],
        ),
    ] {
        let message = Scene::parse("scene.toml", &small_scene(detector, &more)).unwrap_err().to_string();
        assert!(message.starts_with("scene.toml: ") && !message.contains('\n'), "{message}");
        for part in parts {
            assert!(message.contains(part), "{part:?} is not in: {message}");
        }
    }
}

/// Bits alone set the converter's top, in the counts, in what is declared and in a listed converter.
#[test]
fn the_converter_ends_where_its_bits_do() {
    for (detector, top) in [("bits = 8", 255.0), ("bits = 10", 1023.0), ("bits = 10\nsaturation_dn = 900.0", 900.0)] {
        let detector = format!("{detector}\nfull_well_e = 1e6");
        let text = small_scene(&detector, "").replace("full_well_e = 100000.0\n", "").replace("full_well_e = 1.0e5\n", "");
        let scene = Scene::parse("scene.toml", &text).unwrap();
        assert_eq!((scene.detector.top_dn(), scene.detector.full_pixel_dn()), (top, top));
        let most = rendered(&scene).pixels_dn.into_iter().max().unwrap();
        assert_eq!(f64::from(most), top, "{detector}");
    }
    assert_eq!(parse("", "").detector.top_dn(), 65_535.0);
}

/// A star's electrons follow its colour by the factor of the page, in the truth and on the pixels; a star of unknown colour keeps its own.
#[test]
fn electrons_follow_the_colour_of_a_star() {
    let catalog = Catalog::embedded();
    let plain = parse("", "");
    let term = parse("colour_term_mag_per_mag = -0.4", "");
    let curve = "[detector.quantum_efficiency]\nwavelengths_nm = [350.0, 450.0, 550.0, 650.0, 750.0, 900.0, 1000.0]\n\
                 values = [0.2, 0.5, 0.6, 0.55, 0.45, 0.2, 0.05]";
    let curve = parse("", curve);
    let [before, by_term, by_curve] = [&plain, &term, &curve].map(|scene| rendered(scene).stars);
    assert!(before.len() >= 3 && before.len() == by_term.len() && before.len() == by_curve.len(), "{}", before.len());
    let mut coloured = 0;
    for ((star, term), curve) in before.iter().zip(&by_term).zip(&by_curve) {
        let colour = catalog.stars.iter().find(|other| other.hip == star.hip).unwrap().colour;
        let ratio = term.electrons_asked / star.electrons_asked;
        let expected = colour.map_or(1.0, |colour| 10.0_f64.powf(0.4 * 0.4 * (colour - 0.6)));
        assert!((ratio / expected - 1.0).abs() < 1e-12, "HIP {}: {ratio} instead of {expected}", star.hip);
        assert!((term.electrons_landed / star.electrons_landed / expected - 1.0).abs() < 1e-5);
        let ratio = curve.electrons_asked / star.electrons_asked;
        if colour == Some(0.6) || colour.is_none() {
            assert!((ratio - 1.0).abs() < 1e-12);
        } else {
            // Between 0.3 and 0.9 the curve of a silicon detector goes with the colour; a blue star lies on either side.
            assert!(colour.is_some_and(|colour| colour < 0.3) || (ratio > 1.0) == colour.is_some_and(|colour| colour > 0.6), "{ratio}");
            coloured += usize::from((ratio - 1.0).abs() > 0.02);
        }
    }
    assert!(coloured >= 2, "{coloured} stars have a colour");
}

/// Expected electrons of the frame, row by row.
pub(crate) fn expected(scene: &Scene, backend: Backend) -> Option<Vec<f32>> {
    let renderer = Renderer::new(scene, Catalog::embedded(), backend).inspect_err(|error| println!("skipped: {error}")).ok()?;
    Some(renderer.expected_electrons(0).unwrap())
}

/// Filters of the same transmission for all colours change nothing, to the bit; with one that follows the colour, each star's pixels count what the law
/// says, and the truth is what the frame holds.
#[test]
fn filters_share_the_light_of_each_star_by_its_colour() {
    let dark = "[sky]\nbackground_e_per_px_s = 0.0\nfaintest_magnitude = 7.0\nphysics = \"known\"\n";
    let with = |filters: &str| {
        let text = small_scene("", "");
        let text = &text[..text.find("[sky]").unwrap()];
        let frames = "[[frames]]\nboresight_radec_deg = [83.0, -1.0]\nexposure_s = 0.1\n";
        Scene::parse("scene.toml", &format!("{text}{dark}{filters}\n{frames}")).unwrap()
    };
    let plain = expected(&with(""), Backend::Cpu).unwrap();
    assert_eq!(expected(&with("[detector.colour_filters]\nrelative_per_mag = 0.0"), Backend::Cpu).unwrap(), plain);
    let scene = with("[detector.colour_filters]\nrelative_per_mag = 0.4");
    let through = expected(&scene, Backend::Cpu).unwrap();
    let stars = rendered(&scene).stars;
    let before = rendered(&with("")).stars;
    let catalog = Catalog::embedded();
    let mut tried = 0;
    for (star, before) in stars.iter().zip(&before) {
        assert_eq!((star.hip, star.electrons_asked), (before.hip, before.electrons_asked));
        let (x, y) = (star.x_px.round(), star.y_px.round());
        let colour = catalog.stars.iter().find(|other| other.hip == star.hip).unwrap().colour;
        if star.blended || !(2.0..93.0).contains(&x) || !(2.0..77.0).contains(&y) {
            continue;
        }
        let share = 0.4 * (colour.unwrap_or(0.6) - 0.6);
        for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
            let (x, y) = (x as usize + dx, y as usize + dy);
            let expected = match (x % 2, y % 2) {
                (0, 0) => 1.0 + share,
                (1, 1) => 1.0 - share,
                _ => 1.0,
            };
            let ratio = f64::from(through[y * 96 + x]) / f64::from(plain[y * 96 + x]);
            assert!((ratio - expected).abs() < 1e-4, "HIP {} at {x}, {y}: {ratio} instead of {expected}", star.hip);
        }
        let landed: f64 = star.electrons_landed / before.electrons_landed;
        assert!((landed - 1.0).abs() < 0.2 * share.abs() + 1e-6, "{landed}");
        tried += usize::from(share.abs() > 0.02);
    }
    assert!(tried >= 1, "no star to try");
    let all: f64 = through.iter().map(|electrons| f64::from(*electrons)).sum();
    let landed: f64 = stars.iter().map(|star| star.electrons_landed).sum();
    assert!((landed / all - 1.0).abs() < 1e-4, "{landed} of {all}");
    if let Some(on_gpu) = expected(&scene, Backend::Gpu) {
        let floor_e = 1e-6 * stars[0].electrons_asked as f32;
        let far = on_gpu.iter().zip(&through).filter(|(a, b)| (*a - *b).abs() > 1e-5 * b.abs() + floor_e).count();
        assert_eq!(far, 0);
    }
}

/// Curves switch on what the filters do to all light alike, by the colour of the reference, unless the scene says otherwise itself.
#[test]
fn curves_of_filters_weaken_all_light() {
    let curves = "[detector.colour_filters]\nwavelengths_nm = [400.0, 480.0, 550.0, 620.0, 700.0]\nred = [0.0, 0.0, 0.1, 0.9, 0.8]\n\
                  green = [0.0, 0.3, 0.9, 0.2, 0.0]\nblue = [0.8, 0.9, 0.1, 0.0, 0.0]\n";
    let bayer = |scene: &Scene| {
        let effect = scene.pixel_effects.iter().find(|effect| effect.id == "bayer").unwrap();
        ["red_relative", "blue_relative"].map(|name| effect.parameters.iter().find(|(other, _)| other == name).unwrap().1)
    };
    let [red, blue] = bayer(&parse("", curves));
    assert!((red - 1.103_442).abs() < 1e-5 && (blue - 0.934_467).abs() < 1e-5, "{red} {blue}");
    let own = format!("{curves}[[effects]]\nid = \"bayer\"\nparameters = {{ red_relative = 0.5, blue_relative = 0.25 }}");
    assert_eq!(bayer(&parse("", &own)), [0.5, 0.25]);
    // A detector that sees nothing beyond 600 nm leaves the red filters less.
    let blue_sensitive = format!("{curves}[detector.quantum_efficiency]\nwavelengths_nm = [350.0, 500.0, 600.0]\nvalues = [0.8, 0.8, 0.0]");
    assert!(bayer(&parse("", &blue_sensitive))[0] < 0.5);
}
