//! The camera turns while it exposes: where the light lands, against sums that know nothing of the renderer.

use boresight::catalog::{Catalog, Star};
use boresight::coordinates::{Attitude, Direction, PixelPoint};
use boresight::effects::{Context, StarState};
use boresight::imaging::Backend;
use boresight::render::{Renderer, TrueStar};
use boresight::scene::Scene;
use statrs::function::erf::erf;

const DEG: f64 = std::f64::consts::PI / 180.0;

/// Share of a Gaussian's light in the pixel whose centre is this far away, along one axis.
fn share(offset_px: f64, sigma_px: f64) -> f64 {
    let below = |edge: f64| 0.5 * (1.0 + erf(edge / (sigma_px * std::f64::consts::SQRT_2)));
    below(offset_px + 0.5) - below(offset_px - 0.5)
}

/// A catalogue of one star of magnitude 0 in this direction.
pub(crate) fn one_star(ra_deg: f64, dec_deg: f64) -> Catalog {
    let mut catalog = Catalog::embedded().clone();
    let star = Star {
        direction: Direction::from_radec_rad(ra_deg * DEG, dec_deg * DEG),
        magnitude: 0.0,
        proper_motion_rad_yr: None,
        parallax_rad: 0.0,
        ..catalog.stars[0]
    };
    catalog.stars = vec![star];
    catalog
}

fn scene(camera: &str, detector: &str, frames: &str) -> Scene {
    let text = format!(
        "format = \"boresight-scene/1\"\n[camera]\n{camera}\n[detector]\nzero_point_e_per_s = 1.0e6\n{detector}\n\
         [sky]\nbackground_e_per_px_s = 0.0\nphysics = \"none\"\n{frames}"
    );
    Scene::parse("scene.toml", &text).unwrap_or_else(|error| panic!("{error}\n{text}"))
}

fn render(scene: &Scene, catalog: &Catalog) -> (Vec<f64>, Vec<TrueStar>) {
    let renderer = Renderer::new(scene, catalog, Backend::Cpu).unwrap();
    let image = renderer.expected_electrons(0).unwrap().into_iter().map(f64::from).collect();
    (image, renderer.render(0).unwrap().stars)
}

/// The largest difference between two images, as a share of the star's light.
fn worst(image: &[f64], expected: impl Fn(usize, usize) -> f64, width: usize, electrons: f64) -> f64 {
    let difference = |(i, value): (usize, &f64)| (value / electrons - expected(i % width, i / width)).abs();
    image.iter().enumerate().map(difference).fold(0.0, f64::max)
}

/// A camera so long that a turn is an even shift: the trail is a Gaussian drawn out along a line, which has a closed form.
#[test]
fn a_straight_trail_is_the_closed_form() {
    for (sigma, length) in [(0.5, 0.02), (0.5, 0.3), (1.0, 1.7), (0.3, 6.0), (1.2, 25.0), (0.8, 90.0)] {
        let rate = length / 1e6 / 0.5 / DEG;
        let camera = "width_px = 160\nheight_px = 40\nfocal_length_px = 1.0e6";
        let frames = format!("[[frames]]\nexposure_s = 0.5\nboresight_radec_deg = [80.0, 10.0]\nrate_deg_s = [0.0, {rate:e}, 0.0]");
        let scene = scene(camera, &format!("psf_sigma_px = {sigma}"), &frames);
        let (image, truth) = render(&scene, &one_star(80.0 + 3e-4, 10.0 + 1e-4));
        let star = &truth[0];
        // ∫ Φ(z) dz = zΦ(z) + φ(z): the mean over the trail of the share of a pixel.
        let trail = |offset: f64| {
            let integral = |edge: f64| {
                let z = edge / sigma;
                sigma * (0.5 * z * (1.0 + erf(z / std::f64::consts::SQRT_2)) + (-0.5 * z * z).exp() / std::f64::consts::TAU.sqrt())
            };
            let over = |edge: f64| integral(edge + 0.5 * length) - integral(edge - 0.5 * length);
            (over(offset + 0.5) - over(offset - 0.5)) / length
        };
        let expected = |x: usize, y: usize| trail(x as f64 - star.x_px) * share(y as f64 - star.y_px, sigma);
        let off = worst(&image, expected, 160, star.electrons_asked);
        println!("σ {sigma} px, trail {length} px: within {off:.1e} of the light");
        assert!(off < 1e-6, "σ {sigma}, trail {length} px: off by {off:.1e}");
        assert!((star.x_end_px.unwrap() - star.x_start_px.unwrap()).abs() - length < 1e-4, "{star:?}");
        assert!((star.x_mean_px - star.x_px).abs() < 1e-4 && (star.electrons_landed / star.electrons_asked - 1.0).abs() < 1e-6);
    }
}

/// The place of a star in an ideal camera turning at an even rate.
fn place(attitude: &Attitude, rate_deg_s: [f64; 3], time_s: f64, star: &Star, f: f64, middle: [f64; 2]) -> [f64; 2] {
    let turned = attitude.turned(rate_deg_s.map(|component| component * DEG * time_s));
    let [x, y, z] = turned.rows().map(|row| (0..3).map(|axis| row[axis] * star.direction.xyz[axis]).sum::<f64>());
    [middle[0] + f * x / z, middle[1] + f * y / z]
}

/// Roll and tumbling bend the trail, a rolling shutter gives every row its own time: against a sum over rows and 4000 moments.
#[test]
fn bent_trails_and_rolling_shutters_are_what_each_row_sees() {
    const MOMENTS: usize = 4000;
    let (width, height, f) = (120_usize, 100_usize, 300.0);
    for (rate, line_time_us, first_row) in [
        ([0.0, 0.0, 60.0], 0.0, "top"),
        ([5.0, -8.0, 30.0], 0.0, "top"),
        ([6.0, 9.0, 10.0], 300.0, "top"),
        ([6.0, 9.0, 10.0], 300.0, "bottom"),
    ] {
        let shutter =
            if line_time_us > 0.0 { format!("line_time_us = {line_time_us}\nfirst_row = \"{first_row}\"") } else { String::new() };
        let camera = format!("width_px = {width}\nheight_px = {height}\nfocal_length_px = {f}\n{shutter}");
        let frames = format!("[[frames]]\nexposure_s = 0.5\nboresight_radec_deg = [80.0, 10.0]\nrate_deg_s = {rate:?}");
        let sigma = 0.9;
        let scene = scene(&camera, &format!("psf_sigma_px = {sigma}"), &frames);
        let catalog = one_star(84.0, 15.0);
        let (image, truth) = render(&scene, &catalog);
        let sign = if first_row == "bottom" { -1.0 } else { 1.0 };
        let middle = [0.5 * (width as f64 - 1.0), 0.5 * (height as f64 - 1.0)];
        let mut expected = vec![0.0; width * height];
        let (mut mean, mut light) = ([0.0; 2], 0.0);
        for row in 0..height {
            let row_s = sign * line_time_us * 1e-6 * (row as f64 - middle[1]);
            for moment in 0..MOMENTS {
                let time_s = row_s + 0.5 * ((moment as f64 + 0.5) / MOMENTS as f64 - 0.5);
                let [x, y] = place(&scene.exposures.get(0).attitude, rate, time_s, &catalog.stars[0], f, middle);
                let down = share(row as f64 - y, sigma) / MOMENTS as f64;
                for column in (x as usize).saturating_sub(8)..(x as usize + 9).min(width) {
                    let electrons = if down > 1e-12 { down * share(column as f64 - x, sigma) } else { 0.0 };
                    expected[row * width + column] += electrons;
                    mean = [mean[0] + electrons * column as f64, mean[1] + electrons * row as f64];
                    light += electrons;
                }
            }
        }
        let star = &truth[0];
        let off = worst(&image, |x, y| expected[y * width + x], width, star.electrons_asked);
        println!("{rate:?} °/s, {line_time_us} µs from the {first_row}: within {off:.1e} of the light");
        assert!(off < 1e-6, "{rate:?}, {line_time_us} µs: off by {off:.1e}");
        assert!((star.electrons_landed / star.electrons_asked - light).abs() < 2e-6, "{} and {light}", star.electrons_landed);
        // The pixels of a rolling shutter stretch the trail, so its centre of light is not quite the mean place; without one it is.
        let allowed = if line_time_us > 0.0 { 0.05 } else { 1e-4 };
        assert!((star.x_mean_px - mean[0] / light).hypot(star.y_mean_px - mean[1] / light) < allowed, "{star:?} {mean:?}");
    }
}

/// Where the shutter's displacement puts a star is where the renderer puts its middle.
#[test]
fn the_shutter_and_its_displacement_agree() {
    for (rate, first_row) in [([0.3, -0.8, 1.5], "top"), ([0.3, -0.8, 1.5], "bottom"), ([0.0, 0.0, 0.0], "top")] {
        let camera = format!(
            "width_px = 1024\nheight_px = 768\nfocal_length_px = 2900.0\nk1 = 6.0e-9\nline_time_us = 25.0\nfirst_row = \"{first_row}\""
        );
        let frames = format!("[[frames]]\nexposure_s = 0.02\nboresight_radec_deg = [83.0, 5.0]\nrate_deg_s = {rate:?}");
        let scene = scene(&camera, "psf_sigma_px = 1.0", &frames);
        let catalog = Catalog::embedded();
        let exposure = &*scene.exposures.get(0);
        let images = scene.star_images(catalog, 0, 0.0);
        assert!(images.len() > 20);
        let mut moved = 0.0_f64;
        for image in &images {
            let star = catalog.stars.iter().find(|star| star.hip == image.hip).unwrap();
            let direction = exposure.attitude.camera_from_apparent(&exposure.sky.apparent(star, catalog.epoch_yr));
            let context = Context::new(StarState::of(star, catalog.epoch_yr), *exposure.sky.observation());
            let expected: PixelPoint = scene.model.pixel(&direction, &context).unwrap();
            let off = (image.position.x_px - expected.x_px).hypot(image.position.y_px - expected.y_px);
            assert!(off < 1e-7, "{}: {off:.1e} px", image.hip);
            let still = scene.camera.pixel(&direction).unwrap();
            moved = moved.max((still.x_px - expected.x_px).hypot(still.y_px - expected.y_px));
        }
        assert_eq!(moved > 0.2, rate != [0.0; 3], "{moved}");
    }
}

/// An even turn told as attitudes on the way gives the same frame as told as a rate; other jitter falls on every frame, the same each time.
#[test]
fn attitudes_on_the_way_and_jitter() {
    let camera = "width_px = 128\nheight_px = 128\nfocal_length_px = 800.0";
    let rate = [2.0, -3.0, 20.0];
    let attitude = Attitude::from_pointing(80.0 * DEG, 10.0 * DEG, 0.3);
    let samples: Vec<String> = (-3..=3)
        .map(|step| {
            let time = 0.1 * f64::from(step) + 0.01 * f64::from(step * step);
            let [i, j, k, w] = <[f64; 4]>::from(attitude.turned(rate.map(|component| component * DEG * time)));
            format!("[{time}, {i}, {j}, {k}, {w}]")
        })
        .collect();
    let told = [
        format!("boresight_radec_deg = [80.0, 10.0]\nroll_deg = {}\nrate_deg_s = {rate:?}", 0.3 / DEG),
        format!("attitude_samples = [{}]", samples.join(", ")),
    ];
    let catalog = one_star(82.0, 12.0);
    let [even, curve] = told.map(|told| {
        let scene = scene(camera, "", &format!("[[frames]]\nexposure_s = 0.4\n{told}"));
        assert!((scene.exposures.get(0).telemetry.rate_deg_s.unwrap()[2] - 20.0).abs() < 1e-6);
        render(&scene, &catalog).0
    });
    let electrons: f64 = even.iter().sum();
    assert!(electrons > 1e5);
    let off = even.iter().zip(&curve).map(|(a, b)| (a - b).abs() / electrons).fold(0.0, f64::max);
    assert!(off < 1e-7, "{off:.1e}");

    let lines = "[jitter]\nlines = [{ frequency_hz = 7.0, amplitude_arcsec = [200.0, 100.0, 0.0] }]\n\
                 bands = [{ low_hz = 1.0, high_hz = 12.0, sigma_arcsec = [150.0, 150.0, 300.0] }]\n";
    let still = "[[frames]]\nexposure_s = 0.4\nboresight_radec_deg = [80.0, 10.0]\n";
    let trembling = scene(camera, "", &format!("{lines}{still}{still}"));
    let frame = |index: usize| Renderer::new(&trembling, &catalog, Backend::Cpu).unwrap().expected_electrons(index).unwrap();
    assert_eq!(frame(1), frame(1));
    assert_ne!(frame(0), frame(1), "two frames tremble alike");
    // The same sum at 5000 moments of the same motion.
    let (exposure, star) = (&*trembling.exposures.get(0), &catalog.stars[0]);
    let mut expected = vec![0.0; 128 * 128];
    for moment in 0..5000 {
        let attitude = exposure.motion.attitude(&exposure.course, 0.4 * ((f64::from(moment) + 0.5) / 5000.0 - 0.5));
        let [x, y] = place(&attitude, [0.0; 3], 0.0, star, 800.0, [63.5; 2]);
        for (i, pixel) in expected.iter_mut().enumerate() {
            let (dx, dy) = ((i % 128) as f64 - x, (i / 128) as f64 - y);
            if dx.abs() < 10.0 && dy.abs() < 10.0 {
                *pixel += share(dx, 1.2) * share(dy, 1.2) / 5000.0;
            }
        }
    }
    let image: Vec<f64> = frame(0).into_iter().map(f64::from).collect();
    let off = worst(&image, |x, y| expected[y * 128 + x], 128, 0.4e6);
    assert!(off < 1e-6, "{off:.1e}");
}

/// Jitter that is faster than the exposure widens the image by its variance, along the axis on which it acts.
#[test]
fn fast_jitter_widens_images() {
    let camera = "width_px = 129\nheight_px = 129\nfocal_length_px = 20000.0";
    let jitter = "[jitter]\nsigma_arcsec = [10.0, 4.0, 0.0]\nlines = [{ frequency_hz = 900.0, amplitude_arcsec = [6.0, 0.0, 0.0] }]\n";
    let frames = format!("{jitter}[[frames]]\nexposure_s = 0.4\nboresight_radec_deg = [80.0, 10.0]");
    let (image, truth) = render(&scene(camera, "psf_sigma_px = 1.0", &frames), &one_star(80.001, 10.001));
    let (star, arcsec_px) = (&truth[0], 20_000.0 * DEG / 3600.0);
    let moment = |along: &dyn Fn(f64, f64) -> f64| {
        let of = |(i, e): (usize, &f64)| e * along((i % 129) as f64 - star.x_px, (i / 129) as f64 - star.y_px);
        image.iter().enumerate().map(of).sum::<f64>() / star.electrons_landed
    };
    // A turn about x moves the image along y. A pixel adds 1/12.
    let expected = [16.0, 100.0 + 18.0].map(|variance| 1.0 + 1.0 / 12.0 + variance * arcsec_px * arcsec_px);
    for (found, expected) in [moment(&|x, _| x * x), moment(&|_, y| y * y)].into_iter().zip(expected) {
        assert!((found / expected - 1.0).abs() < 1e-4, "{found} instead of {expected}");
    }
    assert!(moment(&|x, y| x * y).abs() < 1e-3 && moment(&|x, _| x).abs() < 1e-4);
}

/// On a fixed mount the zenith stands still in the camera and the stars move by the Earth's rate.
#[test]
fn a_fixed_mount_sees_the_earth_turn() {
    let site = "[site]\nlatitude_deg = 52.0\nlongitude_deg = 4.0\n[mount]\nkind = \"fixed\"\n";
    let frame = |time: &str, more: &str| format!("[[frames]]\ntime_utc = \"{time}\"\nexposure_s = 4.0\n{more}\n");
    let frames =
        format!("{site}{}{}", frame("2026-03-01T22:00:00Z", "boresight_radec_deg = [100.0, 40.0]"), frame("2026-03-01T23:30:00Z", ""));
    let scene = scene("width_px = 256\nheight_px = 256\nfocal_length_px = 2000.0", "", &frames);
    let zenith = |index: usize| {
        let exposure = &*scene.exposures.get(index);
        let zenith = exposure.sky.observation().zenith.unwrap();
        exposure.attitude.camera_from_apparent(&Direction::from_unit(zenith))
    };
    assert!(zenith(0).angle_rad(&zenith(1)) < 1e-9);
    let (_, truth) = render(&scene, &one_star(100.0, 40.0));
    let star = &truth[0];
    let trail = (star.x_end_px.unwrap() - star.x_start_px.unwrap()).hypot(star.y_end_px.unwrap() - star.y_start_px.unwrap());
    let expected = 2000.0 * 4.0 * 7.292_115e-5 * (40.0 * DEG).cos();
    assert!((trail / expected - 1.0).abs() < 1e-3, "{trail} instead of {expected}");
}

/// Every displacement at once, a turning camera, a rolling shutter and jitter: the light's centre is where the truth says.
#[test]
fn the_centre_of_light_is_the_truth() {
    const HALF: usize = 22;
    let effects: Vec<String> = boresight::effects::DISPLACEMENTS
        .iter()
        .filter(|effect| effect.segment() != boresight::effects::Segment::Projection)
        .filter(|effect| !["brown-conrady", "rolling-shutter"].contains(&effect.id()))
        .map(|effect| {
            let parameters: Vec<String> = effect.parameters().iter().map(|spec| format!("{} = {:?}", spec.name, spec.typical)).collect();
            format!("[[effects]]\nid = \"{}\"\nparameters = {{ {} }}\n", effect.id(), parameters.join(", "))
        })
        .collect();
    let start = boresight::scene::DEMO_TOML.find("[site]").unwrap();
    let sky = boresight::scene::DEMO_TOML[..start]
        .replace("faintest_magnitude = 8.5", "faintest_magnitude = 4.5")
        .replace("p2 = -1.0e-7", "p2 = -1.0e-7\nline_time_us = 1.0")
        .replace("background_e_per_px_s = 25.0", "background_e_per_px_s = 0.0");
    let effects = effects.concat();
    let text = format!(
        "{sky}[site]\nlatitude_deg = 37.2\nlongitude_deg = -2.5\n[jitter]\nlines = [{{ frequency_hz = 11.0, amplitude_arcsec = [30.0, 20.0, 50.0] }}]\n\
         {effects}[[frames]]\ntime_utc = \"2026-03-01T20:00:00Z\"\nexposure_s = 0.1\nboresight_radec_deg = [84.0, 0.0]\ntemperature_c = 12.0\n\
         pressure_hpa = 780.0\nrate_deg_s = [0.6, -0.4, 2.0]\n"
    );
    let scene = Scene::parse("scene.toml", &text).unwrap();
    let (image, truth) = render(&scene, Catalog::embedded());
    let (mut worst, mut count) = (0.0_f64, 0);
    for star in truth.iter().filter(|star| !star.blended && !star.edge) {
        let (cx, cy) = (star.x_mean_px.round() as usize, star.y_mean_px.round() as usize);
        let apart = |other: &TrueStar| {
            other.hip == star.hip || (other.x_px - star.x_px).abs().max((other.y_px - star.y_px).abs()) > 2.2 * HALF as f64
        };
        if !truth.iter().all(apart) || !(HALF..1024 - HALF).contains(&cx) || !(HALF..1024 - HALF).contains(&cy) {
            continue;
        }
        let (mut light, mut x, mut y) = (0.0, 0.0, 0.0);
        for row in cy - HALF..=cy + HALF {
            for column in cx - HALF..=cx + HALF {
                let e = image[row * 1024 + column];
                (light, x, y) = (light + e, x + e * column as f64, y + e * row as f64);
            }
        }
        worst = worst.max((x / light - star.x_mean_px).hypot(y / light - star.y_mean_px));
        assert!((light / star.electrons_landed - 1.0).abs() < 1e-5);
        count += 1;
    }
    println!("{count} stars, centres within {worst:.1e} px");
    assert!(count > 10 && worst < 1e-4, "{count} stars, {worst:.1e} px");
}
