//! What truth says of the light of a star that pixels have worked on.

use boresight::catalog::Catalog;
use boresight::imaging::Backend;
use boresight::render::{MaskFlag, Renderer, TrueStar};
use boresight::scene::Scene;

use crate::motion::one_star;

const SIDE: usize = 96;

/// A small camera on stars that are far apart, with these tables of effects.
fn scene(detector: &str, effects: &str, exposure_s: f64) -> Scene {
    let text = format!(
        "format = \"boresight-scene/1\"\n[camera]\nwidth_px = {SIDE}\nheight_px = {SIDE}\nfocal_length_px = 1000.0\n\
         [detector]\nzero_point_e_per_s = 1.0e6\n{detector}\n[sky]\nbackground_e_per_px_s = 40.0\nphysics = \"none\"\n{effects}\n\
         [[frames]]\nexposure_s = {exposure_s}\nboresight_radec_deg = [80.0, 10.0]\ntemperature_c = 20.0\n"
    );
    Scene::parse("scene.toml", &text).unwrap_or_else(|error| panic!("{error}\n{text}"))
}

fn effect(id: &str, parameters: &str) -> String {
    format!("[[effects]]\nid = \"{id}\"\nparameters = {{ {parameters} }}\n")
}

/// The truth of a star beside the middle of the frame.
fn star(scene: &Scene) -> TrueStar {
    Renderer::new(scene, &catalog(), Backend::Cpu).unwrap().render(0).unwrap().stars[0]
}

fn catalog() -> Catalog {
    one_star(81.275, 8.9)
}

/// What weakens light on its way weakens what truth says of it, and the sky under the star is that of the rendered frame.
#[test]
fn what_lands_is_what_is_rendered() {
    let stars = catalog();
    let weak = [
        effect("vignetting", "cos4_corner_deg = 30.0, loss_at_corner = 0.2"),
        effect("bayer", "red_relative = 0.4, blue_relative = 0.7"),
        effect("prnu", "relative = 0.05"),
        effect("dark-current", "dark_e_per_px_s = 30.0, dsnu_relative = 0.3"),
        effect("stray-light", "slope_x_e_per_px_s = 0.2"),
    ];
    let scene = scene("psf_sigma_px = 0.8", &weak.concat(), 0.5);
    let image = |catalog: &Catalog| Renderer::new(&scene, catalog, Backend::Cpu).unwrap().expected_electrons(0).unwrap();
    let (lit, dark) = (image(&stars), image(&one_star(260.0, -10.0)));
    let own: Vec<f64> = lit.iter().zip(&dark).map(|(lit, dark)| f64::from(lit - dark)).collect();
    let truth = star(&scene);
    let (landed, peak) = (own.iter().sum::<f64>(), own.iter().copied().fold(0.0, f64::max));
    assert!((truth.electrons_landed / landed - 1.0).abs() < 2e-6, "{} of {landed}", truth.electrons_landed);
    assert!((truth.peak_electrons / peak - 1.0).abs() < 2e-6, "{} of {peak}", truth.peak_electrons);
    assert!(truth.electrons_landed < 0.8 * truth.electrons_asked && !truth.edge, "{truth:?}");
    let brightest = own.iter().position(|electrons| *electrons == peak).unwrap();
    assert!((truth.background_e / f64::from(dark[brightest]) - 1.0).abs() < 1e-6, "{truth:?}");
    // Rounding to counts adds its own.
    let read_variance = scene.detector.read_noise_e.powi(2) + scene.detector.gain_e_per_dn.powi(2) / 12.0;
    let information: f64 = own.iter().zip(&dark).map(|(own, dark)| own * own / (own + f64::from(*dark) + read_variance)).sum();
    assert!((truth.snr / information.sqrt() - 1.0).abs() < 1e-5, "{} for {}", truth.snr, information.sqrt());
}

/// A star beyond the circle of a stop is asked for and does not land; a veil takes its share.
#[test]
fn stops_and_veils_take_their_light() {
    let stopped = star(&scene("", &effect("field-stop", "radius_px = 10.0, edge_px = 1.0"), 0.5));
    assert!(stopped.electrons_asked > 1e5 && stopped.electrons_landed < 1.0 && !stopped.edge, "{stopped:?}");
    let [plain, veiled] = [String::new(), effect("veiling-glare", "share = 0.05")].map(|effects| star(&scene("", &effects, 0.5)));
    assert!((veiled.electrons_landed / plain.electrons_landed - 0.95).abs() < 1e-6, "{veiled:?}");
    let veil = 0.05 * plain.electrons_asked / (SIDE * SIDE) as f64;
    assert!((veiled.background_e - plain.background_e - veil).abs() < 1e-4 * veil, "{veiled:?}");
}

/// A star is saturated where its own pixel is full: by its full well, its converter, its gain, or what stands in the way of the light.
#[test]
fn a_full_pixel_is_that_of_its_own_converter() {
    let peak = star(&scene("", "", 0.5)).peak_electrons;
    let full = |detector: &str, effects: &str| star(&scene(detector, effects, 0.5)).saturated;
    for (share, is_full) in [(0.9, true), (1.2, false)] {
        let well = share * (peak + 20.0);
        assert_eq!(full(&format!("full_well_e = {well}"), ""), is_full, "full well");
        assert_eq!(full("", &effect("blooming", &format!("full_well_e = {well}"))), is_full, "blooming");
        assert_eq!(full(&format!("gain_e_per_dn = {}\nbias_dn = 0.0", well / 65_535.0), ""), is_full, "converter");
    }
    let just = format!("full_well_e = {}", 0.9 * peak);
    assert!(!full(&just, &effect("vignetting", "loss_at_corner = 0.0, cos4_corner_deg = 60.0")), "a vignetted star");
    let almost = format!("full_well_e = {}", 1.1 * peak);
    assert!(full(&almost, &effect("amplifier-step", "gain_relative = 0.2, offset_e = 0.0")), "a star in the half with the larger gain");
}

/// The columns of pixel effects against closed forms: ripples of the gain, a tail of the video signal, a gain, a response that bends.
#[test]
fn what_pixel_effects_add_has_its_closed_form() {
    use std::f64::consts::PI;
    let plain = star(&scene("psf_sigma_px = 0.8", "", 0.5));
    assert_eq!((plain.x_pixels_px, plain.y_pixels_px, plain.flux_pixels_ratio), (Some(0.0), Some(0.0), Some(1.0)));
    let told = |effects: &str| {
        let star = star(&scene("psf_sigma_px = 0.8\nfull_well_e = 1.0e6", effects, 0.5));
        assert!((star.x_px, star.y_px) == (plain.x_px, plain.y_px), "the truth of the place holds no pixel effect");
        [star.x_pixels_px.unwrap(), star.y_pixels_px.unwrap(), star.flux_pixels_ratio.unwrap()]
    };
    // Columns of the gains 1 + ε and 1 − ε, by Poisson's sum: −4 e^(−π²σ²/2)·(σ² + 1/π²)·ε·sin πx, and the flux changes by
    // 2·(2/π)·e^(−π²σ²/2)·ε·cos πx.
    let [x, y, flux] = told(&effect("even-odd", "gain_relative = 0.01"));
    let fall = (-PI * PI * 0.32).exp();
    let flux_ripple = 0.01 * 2.0 / PI * 2.0 * fall * (PI * plain.x_px).cos();
    let expected = -0.01 * 4.0 * fall * (0.64 + 1.0 / (PI * PI)) * (PI * plain.x_px).sin() / (1.0 + flux_ripple);
    assert!(expected.abs() > 3e-4, "the star stands where the ripple moves nothing: {}", plain.x_px);
    assert!((x - expected).abs() < 2e-6 && y.abs() < 1e-6, "{x}, {y} for {expected}");
    assert!((flux - 1.0).abs() < 0.002, "{flux}");
    // A tail of the share k whose mean length is 1/(1 − e^(−1/τ)).
    let [x, y, flux] = told(&effect("overshoot", "tail_relative = 0.01, tail_px = 0.5"));
    let expected = 0.01 / -(-2.0_f64).exp_m1();
    assert!((x / expected - 1.0).abs() < 0.003 && y.abs() < 1e-6 && (flux - 1.0).abs() < 1e-4, "{x}, {y}, {flux} for {expected}");
    let [x, y, flux] = told(&effect("amplifier-step", "gain_relative = 0.03, offset_e = 50.0"));
    assert!(x.abs() < 1e-6 && y.abs() < 1e-6 && (flux - 1.03).abs() < 1e-6, "{x}, {y}, {flux}");
    // Σ N·(1 − α·N/W) over Σ N, of the star's light less the sky's: a Gaussian of F electrons on a sky B loses α/W·(F/(4πσ²) + 2B).
    let [x, y, flux] = told(&effect("nonlinearity", "relative_at_full = 0.02, full_well_e = 1.0e6"));
    let width2 = 0.64 + 1.0 / 12.0;
    let expected = 1.0 - 0.02 / 1e6 * (plain.electrons_asked / (4.0 * PI * width2) + 40.0);
    assert!(x.abs() < 2e-5 && y.abs() < 2e-5 && ((flux - expected) / (1.0 - expected)).abs() < 0.02, "{x}, {y}, {flux} for {expected}");
    // A Bayer pattern and unequal pixels act on the light, before the charge; their shifts are told as well.
    let [x, y, _] = told(&effect("bayer", "red_relative = 0.5, blue_relative = 1.0"));
    assert!(x.abs() > 1e-3 && y.abs() > 1e-3, "{x}, {y}");
}

/// The columns of joined pixels, in joined pixels: what follows the amplifier sees joined charge, what comes before sees the detector's own pixels.
#[test]
fn what_pixel_effects_add_to_joined_pixels_has_its_closed_form() {
    use std::f64::consts::PI;
    let told = |binning: &str, effects: &str| {
        let text = format!("[camera.binning]\nfactor = 2\n{binning}\n{effects}");
        let star = star(&scene("psf_sigma_px = 0.8\nfull_well_e = 1.0e6\nbits = 12", &text, 0.5));
        (star, [star.x_pixels_px.unwrap(), star.y_pixels_px.unwrap(), star.flux_pixels_ratio.unwrap()])
    };
    let ways = ["", "method = \"mean\"", "method = \"mean\"\nplace = \"digital\""];
    let tail = effect("overshoot", "tail_relative = 0.01, tail_px = 0.5");
    for (way, side) in ways.into_iter().zip([1.0, 1.0, 0.5]) {
        assert_eq!(told(way, "").1, [0.0, 0.0, 1.0], "{way}");
        // The tail's length is in pixels that are read: joined ones, or the detector's own.
        let (_, [x, y, flux]) = told(way, &tail);
        let expected = side * 0.01 / -(-2.0_f64).exp_m1();
        assert!(
            (x / expected - 1.0).abs() < 0.003 && y.abs() < 1e-6 && (flux - 1.0).abs() < 1e-4,
            "{way}: {x}, {y}, {flux} for {expected}"
        );
        let (_, [x, y, flux]) = told(way, &effect("amplifier-step", "gain_relative = 0.03, offset_e = 50.0"));
        assert!(x.abs() < 2e-6 && y.abs() < 2e-6 && (flux - 1.03).abs() < 2e-6, "{way}: {x}, {y}, {flux}");
    }
    // The ripple of unequal columns, as of single pixels.
    let (star, [x, y, _]) = told("", &effect("even-odd", "gain_relative = 0.01"));
    let fall = (-PI * PI * 0.32).exp();
    let flux_ripple = 0.01 * 2.0 / PI * 2.0 * fall * (PI * star.x_px).cos();
    let expected = -0.01 * 4.0 * fall * (0.64 + 1.0 / (PI * PI)) * (PI * star.x_px).sin() / (1.0 + flux_ripple);
    assert!(expected.abs() > 3e-4 && (x - expected).abs() < 2e-6 && y.abs() < 1e-6, "{x}, {y} for {expected}");
    // A response that bends, with as much charge as reaches the amplifier: a Gaussian in pixels of side 1 (½ of its own), with a quarter of the charge
    // where it is weakened to the mean, and each of four pixels by itself where counts are joined.
    for (way, charge, side) in [(ways[0], 1.0, 1.0_f64), (ways[1], 0.25, 1.0), (ways[2], 0.25, 0.5)] {
        let (star, [x, y, flux]) = told(way, &effect("nonlinearity", "relative_at_full = 0.02, full_well_e = 1.0e6"));
        let width2 = 0.64 + side * side / 12.0;
        let expected = 1.0 - 0.02 / 1e6 * charge * (star.electrons_asked / (4.0 * PI * width2) + 40.0);
        assert!(x.abs() < 2e-5 && y.abs() < 2e-5, "{way}: {x}, {y}");
        assert!(((flux - expected) / (1.0 - expected)).abs() < 0.02, "{way}: {flux} for {expected}");
    }
    // What acts on the light sees the detector's own pixels: a Bayer pattern has a period of one joined pixel, which is only seen in what it takes.
    let (_, [x, y, flux]) = told("", &effect("bayer", "red_relative = 0.5, blue_relative = 0.9"));
    assert!(x.abs() < 0.3 && y.abs() < 0.3 && (flux - 0.85).abs() < 0.002, "{x}, {y}, {flux}");
}

/// A response within the pixel is a pixel effect too: its columns hold what the same star loses against pixels that answer evenly.
#[test]
fn a_response_within_the_pixel_is_told() {
    let uneven = |response: &str| format!("[psf]\nkind = \"gaussian\"\nparameters = {{ sigma_px = 0.6 }}\n[psf.pixel]\n{response}\n");
    let stars = one_star(81.29, 8.9);
    let [flat, sensitive] = ["cosine = [0.0, 0.0]", "cosine = [0.3, 0.0]"].map(|response| {
        let scene = scene("", &uneven(response), 0.5);
        Renderer::new(&scene, &stars, Backend::Cpu).unwrap().render(0).unwrap().stars[0]
    });
    assert!(flat.x_pixels_px.unwrap().abs() < 1e-9 && flat.y_pixels_px.unwrap().abs() < 1e-9, "{flat:?}");
    // The weight 1 + a·cos 2πu, by Poisson's sum: (a/π)·e^(−2π²σ²)·(1/4 − 2π²σ²)·sin 2πx.
    let angle = 2.0 * std::f64::consts::PI.powi(2) * 0.36;
    let expected = 0.3 / std::f64::consts::PI * (-angle).exp() * (0.25 - angle) * (std::f64::consts::TAU * sensitive.x_px).sin();
    let (x, y) = (sensitive.x_pixels_px.unwrap(), sensitive.y_pixels_px.unwrap());
    assert!(expected.abs() > 1e-4 && (x / expected - 1.0).abs() < 0.02 && y.abs() < 1e-6, "{x}, {y} for {expected}");
}

/// Columns are empty where another star or the edge is too near, and where nobody asked.
#[test]
fn columns_of_pixel_effects_are_empty_where_they_cannot_be_told() {
    let scene = scene("", &effect("overshoot", "tail_relative = 0.01, tail_px = 1.0"), 0.5);
    let mut stars = catalog();
    let told = |stars: &Catalog, asked: bool| {
        let renderer = Renderer::new(&scene, stars, Backend::Cpu).unwrap().with_pixel_shifts(asked);
        renderer.render(0).unwrap().stars.iter().map(|star| star.x_pixels_px.is_some()).collect::<Vec<_>>()
    };
    assert_eq!(told(&stars, true), [true]);
    assert_eq!(told(&stars, false), [false]);
    let mut companion = one_star(81.5, 8.9).stars[0];
    companion.magnitude = 3.0;
    stars.stars.push(companion);
    assert_eq!(told(&stars, true), [false, false]);
    assert_eq!(told(&one_star(80.0 + 2.75, 10.0), true), [false], "at the edge");
}

/// The ideal place is the catalogue's direction through an ideal camera: what lies between it and the place is all that displaces.
#[test]
fn the_ideal_place_knows_no_displacement() {
    let scene = Scene::demo().unwrap();
    let truth = Renderer::new(&scene, Catalog::embedded(), Backend::Cpu).unwrap().render(2).unwrap();
    let attitude = scene.exposures.get(2).attitude.rows();
    let mut displaced = 0.0_f64;
    for star in truth.stars.iter().take(50) {
        let own = Catalog::embedded().stars.iter().find(|own| own.hip == star.hip).unwrap();
        let [x, y, z] = attitude.map(|row| (0..3).map(|axis| row[axis] * own.direction.xyz[axis]).sum::<f64>());
        let [x0, y0] = scene.camera.principal_point_px;
        let f = scene.camera.focal_length_px;
        let ideal = [star.x_ideal_px.unwrap(), star.y_ideal_px.unwrap()];
        assert!((ideal[0] - x0 - f * x / z).abs() < 1e-8 && (ideal[1] - y0 - f * y / z).abs() < 1e-8, "{star:?}");
        displaced = displaced.max((ideal[0] - star.x_px).hypot(ideal[1] - star.y_px));
    }
    assert!(displaced > 0.3 && displaced < 10.0, "{displaced} px");
}

/// Masks against what is known of the scene: flags stand where a trail, a ghost, particles, defects and full pixels are, and nowhere else.
#[test]
fn masks_say_what_is_in_a_pixel() {
    let scene_with = |tables: &str| scene("full_well_e = 3.0e4\nread_noise_e = 2.0", tables, 0.5);
    let masked = |scene: &Scene| {
        let stars = catalog();
        let renderer = Renderer::new(scene, &stars, Backend::Cpu).unwrap().with_masks(true).with_clean(true);
        let frame = renderer.render(0).unwrap();
        assert_eq!(frame.clean_e.as_ref(), Some(&renderer.expected_electrons(0).unwrap()));
        (frame.mask.unwrap(), frame.pixels_dn, frame.stars[0])
    };
    let of = |mask: &[u16], flag: u16| mask.iter().enumerate().filter(|(_, flags)| *flags & flag != 0).map(|(i, _)| i).collect::<Vec<_>>();
    let places = |mask: &[u16], flag: u16| of(mask, flag).into_iter().map(|i| ((i % SIDE) as f64, (i / SIDE) as f64)).collect::<Vec<_>>();

    let (mask, ..) = masked(&scene("", "", 0.01)); // a hundredth of a second fills no pixel
    assert!(mask.iter().all(|flags| *flags == 0), "a frame without faults");

    let lights = "[[streaks]]\nkind = \"satellite\"\nframe = 0\nstart_px = [5.0, 80.0]\nend_px = [30.0, 90.0]\nelectrons = 1.0e5\n\
                  [[ghosts]]\nscale = -1.0\nfraction = 0.01\nradius_px = 6.0\n[cosmic_rays]\nexpected_per_s = 10.0\n";
    let (mask, pixels_dn, star) = masked(&scene_with(lights));
    let trail = places(&mask, MaskFlag::TRAIL);
    let off_line = |(x, y): &(f64, f64)| ((x - 5.0) * 10.0 - (y - 80.0) * 25.0).abs() / 10.0_f64.hypot(25.0);
    assert!((80..500).contains(&trail.len()) && trail.iter().all(|place| off_line(place) < 7.0), "{} pixels", trail.len());
    let ghost = places(&mask, MaskFlag::GHOST);
    let middle = 0.5 * (SIDE as f64 - 1.0);
    let off_ghost = |(x, y): &(f64, f64)| (x - 2.0 * middle + star.x_px).hypot(y - 2.0 * middle + star.y_px);
    assert!((90..150).contains(&ghost.len()) && ghost.iter().all(|place| off_ghost(place) < 7.5), "{} pixels", ghost.len());
    assert!(!of(&mask, MaskFlag::COSMIC_RAY).is_empty());
    let full: Vec<usize> =
        (0..pixels_dn.len()).filter(|i| f64::from(pixels_dn[*i]) >= scene_with(lights).detector.full_pixel_dn()).collect();
    assert!(star.saturated && !full.is_empty() && of(&mask, MaskFlag::SATURATED) == full, "{} full pixels", full.len());
    assert!(of(&mask, MaskFlag::HOT | MaskFlag::DEAD | MaskFlag::TELEGRAPH | MaskFlag::BLOOMED).is_empty());

    let defects = effect("hot-pixels", "hot_per_million = 3000.0, dead_per_million = 2000.0, level_e_per_px_s = 4000.0")
        + &effect(
            "random-telegraph",
            "rts_per_million = 4000.0, level_e_per_px_s = 4000.0, low_dwell_frames = 2.0, high_dwell_frames = 2.0",
        )
        + &effect("blooming", "full_well_e = 3.0e4");
    let (mask, ..) = masked(&scene_with(&defects));
    let with = Renderer::new(&scene_with(&defects), &one_star(260.0, -10.0), Backend::Cpu).unwrap().expected_electrons(0).unwrap();
    let hotter: Vec<usize> = (0..with.len()).filter(|i| with[*i] > 20.1).collect();
    let blind: Vec<usize> = (0..with.len()).filter(|i| with[*i] == 0.0).collect();
    let marked = of(&mask, MaskFlag::HOT | MaskFlag::TELEGRAPH);
    assert!(!of(&mask, MaskFlag::HOT).is_empty() && !of(&mask, MaskFlag::TELEGRAPH).is_empty() && !blind.is_empty());
    assert!(hotter.iter().all(|i| marked.contains(i)), "{hotter:?} in {marked:?}");
    assert_eq!(of(&mask, MaskFlag::DEAD), blind);
    // Charge goes along the column of the star, up and down.
    let bloomed = places(&mask, MaskFlag::BLOOMED);
    assert!(bloomed.len() >= 5 && bloomed.iter().all(|(x, _)| (x - star.x_px).abs() < 5.0), "{bloomed:?}");
    let rows = bloomed.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], (_, y)| [low.min(*y), high.max(*y)]);
    assert!(rows[0] < star.y_px - 1.5 && rows[1] > star.y_px + 1.5, "{rows:?}");
}
