//! Scenes with other images of stars than round Gaussians, and with light that no star sends.

use std::collections::BTreeMap;

use boresight::catalog::Catalog;
use boresight::imaging::Backend;
use boresight::render::{Rendered, Renderer, TrueStar};
use boresight::scene::{DEMO_TOML, LightKind, Scene};

const SIDE: usize = 512;

fn text(more: &str, frames: &str) -> String {
    let start = DEMO_TOML.find("[site]").unwrap();
    let head = DEMO_TOML[..start]
        .replace("width_px = 1024", "width_px = 512")
        .replace("height_px = 1024", "height_px = 512")
        .replace("principal_point_px = [518.3, 506.1]", "principal_point_px = [258.4, 252.2]")
        .replace("faintest_magnitude = 8.5", "faintest_magnitude = 6.0")
        .replace("background_e_per_px_s = 25.0", "background_e_per_px_s = 0.0")
        .replace("physics = \"known\"", "physics = \"none\"");
    format!("{head}\n{more}\n{frames}")
}

fn scene(more: &str) -> Scene {
    let text = text(more, "[[frames]]\nexposure_s = 0.1\nboresight_radec_deg = [84.0, 0.0]\nrate_deg_s = [0.3, -0.2, 0.0]\n");
    Scene::parse("scene.toml", &text).unwrap_or_else(|error| panic!("{error}"))
}

fn render(scene: &Scene) -> (Vec<f64>, Rendered) {
    let renderer = Renderer::new(scene, Catalog::embedded(), Backend::Cpu).unwrap();
    let image = renderer.expected_electrons(0).unwrap().into_iter().map(f64::from).collect();
    (image, renderer.render(0).unwrap())
}

/// Light and centre of the square of ±half px around a star, for stars that stand alone.
fn measured(image: &[f64], truth: &[TrueStar], half: usize) -> BTreeMap<u32, [f64; 3]> {
    let mut found = BTreeMap::new();
    for star in truth {
        let (cx, cy) = (star.x_mean_px.round() as usize, star.y_mean_px.round() as usize);
        let inside = |centre: usize| (half..SIDE - half).contains(&centre);
        let far = |other: &TrueStar| {
            other.hip == star.hip || (other.x_px - star.x_px).abs().max((other.y_px - star.y_px).abs()) > 2.3 * half as f64
        };
        if !inside(cx) || !inside(cy) || !truth.iter().all(far) {
            continue;
        }
        let (mut light, mut x, mut y) = (0.0, 0.0, 0.0);
        for row in cy - half..=cy + half {
            for column in cx - half..=cx + half {
                let e = image[row * SIDE + column];
                (light, x, y) = (light + e, x + e * column as f64, y + e * row as f64);
            }
        }
        found.insert(star.hip, [light, x / light, y / light]);
    }
    found
}

/// Whatever the image of a star, its light has its centre where the truth says, and as much of it lands.
#[test]
fn every_kind_of_image_lands_where_the_truth_says() {
    for (psf, half) in [
        ("kind = \"gaussian\"\nparameters = { sigma_px = 0.8 }\nvary = [{ parameter = \"sigma_px\", coefficient = 0.3, x = 2 }]", 12),
        (
            "kind = \"elliptic-gaussian\"\nparameters = { sigma_major_px = 1.3, sigma_minor_px = 0.9, angle_deg = 20.0 }\n\
             vary = [{ parameter = \"angle_deg\", coefficient = 40.0, x = 1, y = 1 }]",
            14,
        ),
        ("kind = \"moffat\"\nreach_px = 12\nparameters = { fwhm_px = 2.4, beta = 3.0 }", 15),
        (
            "kind = \"airy\"\nreach_px = 12\nfield_nodes = [2, 2]\nparameters = { lambda_n_px = 1.4, obstruction = 0.2 }\n\
             vary = [{ parameter = \"lambda_n_px\", coefficient = 0.06, colour = 1 }]",
            15,
        ),
        (
            "kind = \"zernike\"\nreach_px = 12\nfield_nodes = [3, 2]\nparameters = { lambda_n_px = 1.2, z4_waves = 0.05 }\n\
             vary = [{ parameter = \"z7_waves\", coefficient = 0.1, y = 1 }, { parameter = \"z8_waves\", coefficient = 0.1, x = 1 }]",
            15,
        ),
        ("kind = \"gaussian\"\nparameters = { sigma_px = 0.9 }\npixel = { diffusion_px = 0.2 }", 12),
    ] {
        let scene = scene(&format!("[psf]\n{psf}\n"));
        let (image, rendered) = render(&scene);
        let found = measured(&image, &rendered.stars, half);
        let mut worst = 0.0_f64;
        for star in rendered.stars.iter().filter(|star| found.contains_key(&star.hip)) {
            let [light, x, y] = found[&star.hip];
            worst = worst.max((x - star.x_mean_px).hypot(y - star.y_mean_px));
            assert!((light / star.electrons_landed - 1.0).abs() < 2e-6, "{psf}: {light} electrons of {}", star.electrons_landed);
            assert!(star.electrons_landed > 0.9 * star.electrons_asked && star.electrons_landed < 1.000_01 * star.electrons_asked);
        }
        println!("{:?}: {} stars, centres within {worst:.1e} px", scene.psf.kind, found.len());
        assert!(found.len() >= 5 && worst < 1e-4, "{psf}: {} stars, {worst:.1e} px", found.len());
    }
}

#[test]
fn bad_images_get_one_clear_sentence() {
    for (psf, words) in [
        ("kind = \"moffatt\"", &["did you mean moffat?"][..]),
        ("kind = \"moffat\"\nparameters = { fwhm_px = 2.0 }", &["moffat needs the parameter beta"][..]),
        ("kind = \"moffat\"\nparameters = { fwhm = 2.0 }", &["moffat has no parameter fwhm; it has fwhm_px, beta"][..]),
        ("kind = \"airy\"\nparameters = { lambda_n_px = 0.01 }", &["lambda_n_px = 0.01 must lie between"][..]),
        ("kind = \"sampled\"", &["psf.image = none must name"][..]),
        ("kind = \"sampled\"\nimage = \"no.fits\"\nimage_points_per_px = 4", &["no.fits"][..]),
        ("kind = \"airy\"\nimage = \"no.fits\"\nparameters = { lambda_n_px = 1.0 }", &["belongs to kind"][..]),
        (
            "kind = \"zernike\"\nfield_nodes = [33, 33]\nparameters = { lambda_n_px = 1.5 }\n\
             vary = [{ parameter = \"z4_waves\", coefficient = 0.1, x = 1 }]",
            &["more than 128 MiB"][..],
        ),
    ] {
        let message = Scene::parse("scene.toml", &format!("{DEMO_TOML}\n[psf]\n{psf}\n")).unwrap_err().to_string();
        assert!(message.starts_with("scene.toml: ") && !message.contains('\n'), "{message}");
        for part in words {
            assert!(message.contains(part), "{part:?} is not in: {message}");
        }
    }
}

/// Ghosts, trails and cosmic rays add their light to that of the stars, and nothing else.
#[test]
fn light_that_no_star_sends_has_its_truth() {
    let dark = scene("");
    let lit = scene(
        "[[ghosts]]\nscale = -0.8\nfraction = 0.01\nradius_px = 12.0\nobstruction = 0.3\n\
         [[streaks]]\nkind = \"satellite\"\nframe = 0\nstart_px = [40.0, 60.0]\nend_px = [400.0, 300.5]\nelectrons = 2.0e5\n\
         [[streaks]]\nkind = \"meteor\"\nexpected_per_frame = 3.0\nelectrons = 1.0e5\nlight_curve = [2.0, 1.0]\n\
         [cosmic_rays]\nexpected_per_s = 300.0\n",
    );
    let ((before, _), (after, rendered)) = (render(&dark), render(&lit));
    let count = |kind: LightKind| rendered.lights.iter().filter(|light| light.kind == kind).count();
    assert!(count(LightKind::Ghost) > 3 && count(LightKind::Satellite) == 1);
    assert!((10..60).contains(&count(LightKind::CosmicRay)), "{}", count(LightKind::CosmicRay));
    assert!((0..12).contains(&count(LightKind::Meteor)));
    let landed: f64 = rendered.lights.iter().map(|light| light.electrons_landed).sum();
    let added: f64 = after.iter().zip(&before).map(|(after, before)| after - before).sum();
    assert!((added / landed - 1.0).abs() < 1e-5, "{added} of {landed} electrons");
    let satellite = rendered.lights.iter().find(|light| light.kind == LightKind::Satellite).unwrap();
    assert!((satellite.electrons_landed / 2.0e5 - 1.0).abs() < 1e-6, "{satellite:?}");
    // An even trail: the same light in every px of its length but for its ends.
    let length = 360.0_f64.hypot(240.5);
    let per_px = 2.0e5 / length / (1.1 * std::f64::consts::TAU.sqrt());
    assert!((satellite.peak_electrons / per_px - 1.0).abs() < 0.1, "{} for {per_px}", satellite.peak_electrons);
    for ghost in rendered.lights.iter().filter(|light| light.kind == LightKind::Ghost) {
        let star = rendered.stars.iter().find(|star| Some(star.hip) == ghost.hip).unwrap();
        assert!((ghost.x_start_px - (258.4 - 0.8 * (star.x_mean_px - 258.4))).abs() < 1e-9);
        let area = std::f64::consts::PI * 144.0 * (1.0 - 0.09);
        assert!((ghost.peak_electrons * area / ghost.electrons_asked - 1.0).abs() < 0.02 || ghost.electrons_landed == 0.0, "{ghost:?}");
    }
    assert_eq!(render(&lit).1, rendered, "the same scene gives other lights");
}

/// A colder frame has a wider image, as the scene says, from a closed form and from tables alike.
#[test]
fn images_follow_the_temperature() {
    for psf in [
        "kind = \"gaussian\"\nparameters = { sigma_px = 1.0 }\nvary = [{ parameter = \"sigma_px\", coefficient = -0.02, temperature = 1 }]",
        "kind = \"moffat\"\nreach_px = 14\nparameters = { fwhm_px = 2.4, beta = 4.0 }\n\
         vary = [{ parameter = \"fwhm_px\", coefficient = -0.05, temperature = 1 }]",
    ] {
        let frame = |kelvin: f64| format!("[[frames]]\nexposure_s = 0.1\nboresight_radec_deg = [84.0, 0.0]\ntemperature_c = {kelvin}\n");
        let text = text(&format!("[psf]\n{psf}\n"), &(frame(-5.0) + &frame(5.0)));
        let scene = Scene::parse("scene.toml", &text).unwrap_or_else(|error| panic!("{error}"));
        let renderer = Renderer::new(&scene, Catalog::embedded(), Backend::Cpu).unwrap();
        let peaks = [0, 1].map(|frame| {
            let stars = renderer.render(frame).unwrap().stars;
            stars.iter().map(|star| star.peak_electrons).fold(0.0, f64::max)
        });
        // Widths 1.1 to 0.9, or 2.65 to 2.15, before the pixel.
        let ratio = peaks[1] / peaks[0];
        assert!((1.25..1.55).contains(&ratio), "{psf}: {peaks:?}");
    }
}

/// An image in a file beside the scene: the same stars as from the Gaussian that it shows.
#[test]
fn images_come_from_files() {
    let directory = tempfile::tempdir().unwrap();
    let (side, points, sigma) = (81_u32, 5.0, 1.0_f64);
    let density = |x: u32, y: u32| {
        let r2 = ((f64::from(x) - 40.0).powi(2) + (f64::from(y) - 40.0).powi(2)) / (points * points);
        (60_000.0 * (-0.5 * r2 / (sigma * sigma)).exp()).round() as u16
    };
    let image = image::ImageBuffer::from_fn(side, side, |x, y| image::Luma([density(x, y)]));
    image.save(directory.path().join("star.png")).unwrap();
    let path = directory.path().join("scene.toml");
    let frame = "[[frames]]\nexposure_s = 0.1\nboresight_radec_deg = [84.0, 0.0]\n";
    std::fs::write(&path, text("[psf]\nkind = \"sampled\"\nimage = \"star.png\"\nimage_points_per_px = 5\nreach_px = 10\n", frame))
        .unwrap();
    let (sampled, rendered) = render(&Scene::open(&path).unwrap());
    let plain = text("[psf]\nkind = \"gaussian\"\nparameters = { sigma_px = 1.0 }\n", frame);
    let (gaussian, _) = render(&Scene::parse("scene.toml", &plain).unwrap());
    let brightest = rendered.stars.iter().map(|star| star.electrons_asked).fold(0.0, f64::max);
    let off = sampled.iter().zip(&gaussian).map(|(a, b)| (a - b).abs() / brightest).fold(0.0, f64::max);
    assert!(off < 2e-5, "{off:.1e} of the light");
}
