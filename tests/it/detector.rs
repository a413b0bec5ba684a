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

fn parse(detector: &str, more: &str) -> Scene {
    Scene::parse("scene.toml", &small_scene(detector, more)).unwrap()
}

fn rendered(scene: &Scene) -> Rendered {
    Renderer::new(scene, Catalog::embedded(), Backend::Cpu).unwrap().render(0).unwrap()
}

#[test]
fn bad_detectors_get_one_clear_sentence() {
    let table = |lines: &str| format!("[detector.quantum_efficiency]\n{lines}");
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
