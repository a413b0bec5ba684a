//! Signatures found by rendering and measuring, beside the formulas that the pages and the displacements have for the same effects.

use boresight::detect::{FixedBackground, fit_forced};
use boresight::effects::{Context, Light, Observation, StarImage, StarState, displacement};
use boresight::frame::Frame;
use boresight::render::{MeasuredStar, StampRenderer, TestStar, signature};
use boresight::scene::Scene;

const SIDE: usize = 192;
const BACKGROUND_E: f64 = 50.0;
const READ_NOISE_E: f64 = 5.0;
/// A sky that adds nothing of note.
const DARK_E: f64 = 0.01;

/// Width σ of the images, and the amplitude of the fit's S-curve per unit of the response's cosine, px: the numbers of the page.
const FITTED_S_CURVES: [(f64, f64); 2] = [(0.5, -1.07e-2), (0.7, -5.2e-5)];

fn scene(psf: &str, effects: &str) -> Scene {
    scene_under(BACKGROUND_E, psf, effects)
}

fn scene_under(background_e: f64, psf: &str, effects: &str) -> Scene {
    let text = format!(
        "format = \"boresight-scene/1\"\n[camera]\nwidth_px = {SIDE}\nheight_px = {SIDE}\nfocal_length_px = 2000.0\n\
         [detector]\nread_noise_e = {READ_NOISE_E}\n[sky]\nbackground_e_per_px_s = {background_e}\nphysics = \"none\"\n{psf}\n{effects}\n\
         [[frames]]\nexposure_s = 1.0\nboresight_radec_deg = [80.0, 10.0]\n"
    );
    Scene::parse("scene.toml", &text).unwrap_or_else(|error| panic!("{error}\n{text}"))
}

fn gaussian(sigma_px: f64) -> String {
    format!("[psf]\nkind = \"gaussian\"\nparameters = {{ sigma_px = {sigma_px} }}\n")
}

/// Seven stars of a frame, in columns and rows of their own, at phases within the pixel that fill it evenly from frame to frame.
fn stars(frame: usize, electrons: f64) -> Vec<TestStar> {
    let phase = |k: usize, step: f64| (step * k as f64).fract() - 0.5;
    (0..7)
        .map(|k| {
            let number = 7 * frame + k;
            let row = (3 * k + frame) % 7;
            let (x, y) = (24.0 + 24.0 * k as f64, 24.0 + 24.0 * row as f64);
            TestStar { x_px: x + phase(number, 0.754_877_666), y_px: y + phase(number, 0.569_840_291), electrons, colour: None }
        })
        .collect()
}

/// Seven frames for each brightness.
fn design(brightnesses: &[f64]) -> Vec<Vec<TestStar>> {
    brightnesses.iter().flat_map(|electrons| (0..7).map(|frame| stars(frame, *electrons))).collect()
}

/// The program's own fit.
fn fitted(sigma_px: f64, sky_e: f64) -> impl Fn(&Frame, &[TestStar]) -> Vec<Option<MeasuredStar>> {
    let noise_dn = (sky_e + READ_NOISE_E * READ_NOISE_E).sqrt();
    let known = FixedBackground { background_dn: sky_e, noise_dn, gain_e_per_dn: 1.0, psf_sigma_px: sigma_px };
    move |frame, stars| {
        let places: Vec<[f64; 2]> = stars.iter().map(|star| [star.x_px.round(), star.y_px.round()]).collect();
        let fits = fit_forced(frame, &places, &known).into_iter();
        fits.map(|fit| {
            fit.map(|fit| MeasuredStar { x_px: fit.x_px, y_px: fit.y_px, flux_e: fit.flux_dn, variance_px2: fit.width_px * fit.width_px })
        })
        .collect()
    }
}

/// Centre of mass, flux and variance in a square window.
fn moments(half_px: usize, sky_e: f64) -> impl Fn(&Frame, &[TestStar]) -> Vec<Option<MeasuredStar>> {
    move |frame, stars| {
        let of = |star: &TestStar| {
            let (left, top) = (star.x_px.round() as usize - half_px, star.y_px.round() as usize - half_px);
            let mut sums = [0.0; 5];
            for row in 0..=2 * half_px {
                for column in 0..=2 * half_px {
                    let electrons = f64::from(frame.at(left + column, top + row)) - sky_e;
                    let (x, y) = (column as f64, row as f64);
                    for (sum, part) in sums.iter_mut().zip([1.0, x, y, x * x, y * y]) {
                        *sum += electrons * part;
                    }
                }
            }
            let [flux_e, x, y, xx, yy] = [sums[0], sums[1] / sums[0], sums[2] / sums[0], sums[3] / sums[0], sums[4] / sums[0]];
            let variance_px2 = 0.5 * (xx - x * x + yy - y * y);
            Some(MeasuredStar { x_px: x + left as f64, y_px: y + top as f64, flux_e, variance_px2 })
        };
        stars.iter().map(of).collect()
    }
}

fn columns(
    scenes: [&Scene; 2],
    step: f64,
    design: &[Vec<TestStar>],
    measure: impl Fn(&Frame, &[TestStar]) -> Vec<Option<MeasuredStar>>,
) -> Vec<MeasuredStar> {
    let [weaker, stronger] = scenes.map(|scene| StampRenderer::new(scene).unwrap());
    let found = signature(&weaker, &stronger, step, design, measure).unwrap();
    found.into_iter().map(|one| one.expect("every star of the design is measured")).collect()
}

/// Cosine of the angle between two columns, and the length of the first along the second.
fn compare(found: &[[f64; 2]], formula: &[[f64; 2]]) -> (f64, f64) {
    let product = |a: &[[f64; 2]], b: &[[f64; 2]]| a.iter().flatten().zip(b.iter().flatten()).map(|(a, b)| a * b).sum::<f64>();
    let (own, along, square) = (product(found, found), product(found, formula), product(formula, formula));
    (along / (own * square).sqrt(), along / square)
}

/// The shift of a displacement per unit of its first parameter, for a star of the design.
fn by_formula(id: &str, star: &TestStar, magnitude: f64) -> [f64; 2] {
    let middle = 0.5 * (SIDE as f64 - 1.0);
    let image = StarImage { flux_e: Some(star.electrons), psf_sigma_px: Some(0.9), ..StarImage::default() };
    let state = StarState { magnitude, colour: star.colour, ..StarState::default() };
    let context = Context::new(state, Observation::of_sensor(SIDE, SIDE)).with_image(image);
    let point_px = [star.x_px - middle, star.y_px - middle];
    let light = Light { direction: [0.0, 0.0, 1.0], point_px, pixel_px: [star.x_px, star.y_px], focal_length_px: 2000.0 };
    let effect = displacement(id).unwrap();
    let mut parameters = vec![0.0; effect.parameters().len()];
    parameters[0] = 1.0;
    let moved = effect.displace(&parameters, light, &context).point_px;
    [point_px[0] - moved[0], point_px[1] - moved[1]]
}

fn shifts(found: &[MeasuredStar]) -> Vec<[f64; 2]> {
    found.iter().map(|one| [one.x_px, one.y_px]).collect()
}

/// The columns by the program's fit and by the centre of mass.
fn both(scenes: &[Scene; 2], step: f64, sigma_px: f64, sky_e: f64, design: &[Vec<TestStar>]) -> [Vec<MeasuredStar>; 2] {
    let scenes = [&scenes[0], &scenes[1]];
    [columns(scenes, step, design, fitted(sigma_px, sky_e)), columns(scenes, step, design, moments(7, sky_e))]
}

/// Cosine and size of shifts beside a formula for each star, said and returned.
fn beside(what: &str, found: &[MeasuredStar], design: &[Vec<TestStar>], formula: impl Fn(&TestStar) -> [f64; 2]) -> (f64, f64) {
    let formula: Vec<[f64; 2]> = design.iter().flatten().map(formula).collect();
    let (cosine, size) = compare(&shifts(found), &formula);
    println!("{what}: cosine {cosine:.4}, {size:.4e} times the formula");
    (cosine, size)
}

fn near(found: f64, expected: f64, relative: f64) -> bool {
    (found / expected - 1.0).abs() < relative
}

fn effect(id: &str, parameters: &str) -> String {
    format!("[[effects]]\nid = \"{id}\"\nparameters = {{ {parameters} }}\n")
}

/// Whether the page of an effect says this, line breaks aside.
fn page_says(page: &str, text: &str) {
    let plain = page.split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(plain.contains(text), "the page does not say: {text}");
}

/// A pixel whose middle is more sensitive, rendered: an S-curve of the page's form. For the centre of mass it has the size of Poisson's sum,
/// (a/π)·e^(−2π²σ²)·(1/4 − 2π²σ²); the fit's is the number on the page.
#[test]
fn a_response_within_the_pixel_is_an_s_curve() {
    use std::f64::consts::{PI, TAU};
    for (sigma, of_fit) in FITTED_S_CURVES {
        let response = |a: f64| scene(&(gaussian(sigma) + &format!("[psf.pixel]\ncosine = [{a:?}, {a:?}]\n")), "");
        let design = design(&[1e4]);
        let [fit, mass] = both(&[response(-0.05), response(0.05)], 0.1, sigma, BACKGROUND_E, &design);
        let formula = |star: &TestStar| [star.x_px, star.y_px].map(|at| (TAU * at).sin());
        let angle = 2.0 * PI * PI * sigma * sigma;
        let expected = (-angle).exp() * (0.25 - angle) / PI;
        let (cosine, size) = beside(&format!("response within the pixel, σ {sigma} px, centre of mass"), &mass, &design, formula);
        assert!(cosine < -0.999 && near(size, expected, 0.01), "{cosine} {size} for {expected}");
        let (cosine, size) = beside(&format!("response within the pixel, σ {sigma} px, fit"), &fit, &design, formula);
        assert!(cosine < -0.98 && near(size, of_fit, 0.05), "{cosine} {size} for {of_fit}");
    }
    page_says(&displacement("s-curve").unwrap().page(), "−0.0107·a px for σ = 0.5 px by both; −1.9·10⁻⁴·a and −5·10⁻⁵·a for σ = 0.7 px");
}

/// Losses in transfer, rendered by the charge distortion model, beside the power law: along the columns in proportion to the row at any one
/// brightness; with the root of the flux on a dark sky, less steeply where the sky fills traps.
#[test]
fn losses_in_transfer_follow_the_power_law() {
    let id = "charge-transfer-inefficiency";
    for (sky, least, exponents) in [(DARK_E, 0.993, [0.39, 0.46]), (BACKGROUND_E, 0.97, [0.31, 0.33])] {
        let traps = |n: f64| {
            let text = effect(id, &format!("traps_per_px = {n:?}, release_px = 1.0, cloud_exponent = 0.5"));
            scene_under(sky, &gaussian(0.9), &text)
        };
        let all = design(&[1e3, 1e4, 1e5]);
        let found = both(&[traps(0.01), traps(0.03)], 0.02, 0.9, sky, &all);
        for (name, found, exponent) in [("fit", &found[0], exponents[0]), ("centre of mass", &found[1], exponents[1])] {
            let what = format!("losses in transfer, sky {sky} e-, {name}");
            let mut sizes = Vec::new();
            for (part, frames) in found.chunks(49).zip(all.chunks(7)) {
                let one = beside(&format!("{what}, {:e} e-", frames[0][0].electrons), part, frames, |star| by_formula(id, star, 5.0));
                assert!(one.0 > 0.995, "{what}: rows");
                sizes.push(one.1);
            }
            let found_exponent = 0.5 - (sizes[2] / sizes[0]).log(100.0);
            let (cosine, _) = beside(&format!("{what}, all, exponent {found_exponent:.3}"), found, &all, |star| by_formula(id, star, 5.0));
            assert!(cosine > least && (found_exponent - exponent).abs() < 0.012, "{what}: {cosine}, exponent {found_exponent}");
        }
    }
    let page = displacement(id).unwrap().page();
    page_says(&page, "the exponent is 0.46 by the centre of mass and 0.39 by the fit, 0.33 and 0.31 under a sky of 50 electrons");
}

/// Brighter and fatter, rendered: the variance of the image grows in proportion to the electrons, its centre stays.
#[test]
fn the_brighter_the_fatter() {
    let law = |s: f64| scene(&gaussian(0.9), &effect("brighter-fatter", &format!("shift_px_per_e = {s:e}, range_px = 0.7")));
    let design = design(&[1e4, 1e5, 3e5]);
    for ((name, of_estimator), found) in
        [("fit", 1.09), ("centre of mass", 1.03)].iter().zip(both(&[law(4e-7), law(6e-7)], 2e-7, 0.9, BACKGROUND_E, &design))
    {
        let grown: Vec<[f64; 2]> = found.iter().map(|one| [one.variance_px2, 0.0]).collect();
        // The peak of a star of σ² = 0.81 + 1/12 px².
        let variance = 0.81 + 1.0 / 12.0;
        let peak = |star: &TestStar| [variance * star.electrons / (std::f64::consts::TAU * variance), 0.0];
        let formula: Vec<[f64; 2]> = design.iter().flatten().map(peak).collect();
        let (cosine, size) = compare(&grown, &formula);
        println!("brighter and fatter, {name}: cosine {cosine:.4}, σ² grows by {size:.3} of shift_px_per_e times the peak");
        assert!(cosine > 0.999 && near(size, *of_estimator, 0.02), "{cosine}, {size}");
        let most = found.iter().map(|one| one.x_px.hypot(one.y_px)).fold(0.0, f64::max);
        assert!(5e-7 * most < 1e-5, "{name}: the centre moves by {most} px per unit of the parameter");
    }
    let page = boresight::effects::page_of(boresight::effects::pixel::pixel_effect("brighter_fatter").unwrap().source());
    page_says(&page, "σ² grows by the part 1.03·s·N by its moments, 1.09·s·N by the program's fit");
}

/// Coma, rendered as a wavefront whose coma grows with the field, beside the page's formula: what the fit shifts points along the radius,
/// grows with it and not with its square, and depends on the brightness only where the star outshines the sky.
#[test]
fn coma_moves_bright_stars_otherwise_than_faint_ones() {
    let coma = |c: f64| {
        let vary = |name: &str, axis: &str| format!("{{ parameter = \"{name}\", coefficient = {c:?}, {axis} = 1 }}");
        let terms = [vary("z8_waves", "x"), vary("z7_waves", "y")].join(", ");
        let head = "[psf]\nkind = \"zernike\"\nreach_px = 12\nfield_nodes = [2, 2]\nparameters = { lambda_n_px = 1.6 }\n";
        scene(&format!("{head}vary = [{terms}]\n"), "")
    };
    let brightnesses = [1e3, 1e4, 1e5, 1e6];
    let design = design(&brightnesses);
    let scenes = [coma(-0.01), coma(0.01)];
    let found = columns([&scenes[0], &scenes[1]], 0.02, &design, fitted(0.75, BACKGROUND_E));
    let half = 0.5 * SIDE as f64;
    let along = |star: &TestStar| [star.x_px, star.y_px].map(|at| (at - half + 0.5) / half);
    let mut sizes = Vec::new();
    for (part, frames) in found.chunks(49).zip(design.chunks(7)) {
        let what = format!("coma, {:e} e-", frames[0][0].electrons);
        let (cosine, size) = beside(&format!("{what}, along the radius"), part, frames, along);
        assert!(cosine < -0.998, "{cosine}");
        let [x, y] = [0, 1].map(|axis| move |star: &TestStar| along(star)[axis] * along(star)[0].hypot(along(star)[1]));
        let (square, _) = beside(&format!("{what}, its square"), part, frames, |star| [x(star), y(star)]);
        assert!(square > -0.985, "{square}");
        sizes.push(size);
    }
    // Faint stars alike, bright ones less.
    assert!(near(sizes[1], sizes[0], 0.03) && sizes[2] / sizes[0] < 0.92 && sizes[3] / sizes[0] < 0.7, "{sizes:?}");
    // The part that depends on brightness, beside the formula of the page.
    let middle: Vec<[f64; 2]> = (0..49)
        .map(|k| [0, 1].map(|axis| found[k..].iter().step_by(49).map(|one| [one.x_px, one.y_px][axis]).sum::<f64>() / 4.0))
        .collect();
    let left: Vec<[f64; 2]> =
        found.iter().enumerate().map(|(k, one)| [one.x_px - middle[k % 49][0], one.y_px - middle[k % 49][1]]).collect();
    let magnitude = |star: &TestStar| -2.5 * (star.electrons / 10.0_f64.powf(4.5)).log10() + 5.0;
    let formula: Vec<[f64; 2]> = design.iter().flatten().map(|star| by_formula("coma", star, magnitude(star))).collect();
    let (cosine, _) = compare(&left, &formula);
    println!("coma, the part that depends on brightness, beside the page's formula: cosine {cosine:.3}");
    assert!((-cosine - 0.87).abs() < 0.015, "{cosine}");
    page_says(&displacement("coma").unwrap().page(), "What depends on the brightness has a cosine of 0.87 with this formula");
}

/// Ripples of the gain, rendered, beside their formula for the centre of mass at σ = 0.7 px; the fit sees a little more of them.
#[test]
fn ripples_of_the_gain_follow_their_formulas() {
    let columns_of = |e: f64| scene_under(DARK_E, &gaussian(0.7), &effect("even-odd", &format!("gain_relative = {e:?}")));
    let filters = |e: f64| {
        scene_under(DARK_E, &gaussian(0.7), &effect("bayer", &format!("red_relative = {:?}, blue_relative = {:?}", 1.0 + e, 1.0 - e)))
    };
    let mut design = design(&[1e4]);
    for star in design.iter_mut().flatten() {
        star.colour = Some(1.6); // one magnitude redder than the Sun
    }
    for (id, scenes) in [("even-odd", [columns_of(-0.01), columns_of(0.01)]), ("bayer", [filters(-0.01), filters(0.01)])] {
        let [fit, mass] = both(&scenes, 0.02, 0.7, DARK_E, &design);
        let (cosine, size) = beside(&format!("{id}, centre of mass"), &mass, &design, |star| by_formula(id, star, 5.0));
        assert!(cosine > 0.99 && near(size, 1.0, 0.03), "{id}: {cosine} {size}");
        let (cosine, size) = beside(&format!("{id}, fit"), &fit, &design, |star| by_formula(id, star, 5.0));
        assert!(cosine > 0.99 && near(size, 1.12, 0.03), "{id}: {cosine} {size}");
    }
}

/// A tail of the video signal, rendered: every star is moved by the same, k/(1 − e^(−1/τ)) for the centre of mass, whatever its brightness, so that
/// beside the formula, which goes with the flux, it looks alike at one brightness only.
#[test]
fn a_tail_of_constant_share_moves_all_stars_alike() {
    let tail = |k: f64| scene_under(DARK_E, &gaussian(0.9), &effect("overshoot", &format!("tail_relative = {k:?}, tail_px = 0.8")));
    let all = design(&[1e3, 1e4, 1e5]);
    let found = both(&[tail(0.002), tail(0.006)], 0.004, 0.9, DARK_E, &all);
    let of_mass = 1.0 / -(-1.0_f64 / 0.8).exp_m1();
    for (name, found, shares) in [("fit", &found[0], FITTED_TAIL), ("centre of mass", &found[1], [1.0; 3])] {
        for ((part, frames), share) in found.chunks(49).zip(all.chunks(7)).zip(shares) {
            let electrons = frames[0][0].electrons;
            let what = format!("overshoot, {electrons:e} e-, {name}");
            let (cosine, size) = beside(&what, part, frames, |star| by_formula("overshoot", star, 5.0));
            let found = size * electrons / 1e4 / of_mass;
            println!("{what}: {found:.4} of the tail's mean length");
            assert!(cosine > 0.999 && near(found, share, 0.02), "{what}: {cosine} {found} for {share}");
        }
        // Shifts of three brightnesses beside a formula in proportion to them.
        let [along, own, square] = [0, 1, 2].map(|k| {
            let part = |(share, electrons): (f64, f64)| [share * electrons, share * share, electrons * electrons][k];
            shares.into_iter().zip([1e3, 1e4, 1e5]).map(part).sum::<f64>()
        });
        let expected = along / (own * square).sqrt();
        let (cosine, _) = beside(&format!("overshoot, all, {name}"), found, &all, |star| by_formula("overshoot", star, 5.0));
        assert!((cosine - expected).abs() < 0.005, "{name}: {cosine} for {expected}");
    }
    page_says(
        &displacement("overshoot").unwrap().page(),
        "moves stars of every brightness by the same, k/(1 − e^(−1/τ)) px by the centre of mass",
    );
}

/// What the fit sees of a tail of 0.8 px, over what the centre of mass does, of stars of 10³, 10⁴ and 10⁵ electrons.
const FITTED_TAIL: [f64; 3] = [0.58, 0.70, 0.81];

/// A background that rises evenly, rendered: stars move up the slope in inverse proportion to their electrons. By the centre of mass of 15 × 15 px with
/// the page's K for that; by the program's fit, which is weighted, with more than the K of an unweighted one, the brighter the star.
#[test]
fn a_slope_under_the_images_moves_faint_stars_most() {
    let slope =
        |a: f64| scene(&gaussian(0.9), &effect("stray-light", &format!("slope_x_e_per_px_s = {a:?}, slope_y_e_per_px_s = {:?}", -0.5 * a)));
    let all = design(&[3e3, 3e4, 3e5]);
    let [fit, mass] = both(&[slope(-0.05), slope(0.05)], 0.1, 0.9, BACKGROUND_E, &all);
    // The level of the sky is that of the middle of the frame; elsewhere it is wrong, which moves the centre of mass towards the middle of its window.
    let middle = 0.5 * (SIDE as f64 - 1.0);
    let is_level = |star: &TestStar| (star.x_px - middle - 0.5 * (star.y_px - middle)).abs() < 14.0;
    let of_fit = 8.0 * std::f64::consts::PI * (0.81_f64 + 1.0 / 12.0).powi(2);
    for (name, found, k, shares) in [("fit", &fit, of_fit, FITTED_SLOPE), ("centre of mass", &mass, 225.0 * 7.0 * 8.0 / 3.0, [1.0; 3])] {
        for ((part, frames), share) in found.chunks(49).zip(all.chunks(7)).zip(shares) {
            let level = part.iter().zip(frames.iter().flatten()).filter(|(_, star)| is_level(star));
            let (part, stars): (Vec<MeasuredStar>, Vec<TestStar>) = level.map(|(found, star)| (*found, *star)).unzip();
            let what = format!("stray light, {:e} e-, {name}, {} stars", stars[0].electrons, stars.len());
            let (cosine, size) = beside(&what, &part, &[stars], |star| [1.0, -0.5].map(|along| along * k / star.electrons));
            assert!(cosine > 0.98 && near(size, share, 0.03), "{what}: {cosine} {size} for {share}");
        }
    }
    page_says(&displacement("stray-light").unwrap().page(), "1.7 times for 3000, 3.2 times for 30 000 and 6 times for 300 000 electrons");
}

/// What the program's fit, which trusts bright pixels less, makes of a slope over what an unweighted one does, of stars of 3·10³, 3·10⁴ and 3·10⁵
/// electrons on a sky of 50.
const FITTED_SLOPE: [f64; 3] = [1.662, 3.162, 5.983];

/// Halves of unequal gain, rendered: fluxes of one half, and shifts of stars whose light lies on both sides of the line, by the moments of a cut
/// Gaussian; no star away from it moves, so the page's formula is of another cause.
#[test]
fn halves_of_unequal_gain_move_stars_at_their_line_alone() {
    let halves = |g: f64| scene_under(DARK_E, &gaussian(0.9), &effect("amplifier-step", &format!("gain_relative = {g:?}, offset_e = 0.0")));
    let all = design(&[1e4]);
    let [fit, mass] = both(&[halves(-0.005), halves(0.005)], 0.01, 0.9, DARK_E, &all);
    // Share of a pixel row, by Simpson's rule over a Gaussian of σ = 0.9 px.
    let density = |t: f64| (-0.5 * (t / 0.9).powi(2)).exp() / (0.9 * std::f64::consts::TAU.sqrt());
    let share = |row: f64| {
        let part = |k: f64| (density(row - 0.5 + 0.1 * k) + 4.0 * density(row - 0.45 + 0.1 * k) + density(row - 0.4 + 0.1 * k)) / 60.0;
        (0..10).map(|k| part(f64::from(k))).sum::<f64>()
    };
    let (mut at_line, mut away) = (0, 0);
    for ((star, fit), mass) in all.iter().flatten().zip(&fit).zip(&mass) {
        let below = |row: &f64| *row >= 0.5 * SIDE as f64;
        let rows = || (-9..=9).map(|k| star.y_px.round() + f64::from(k)).filter(below);
        let (flux, shift): (f64, f64) = rows()
            .map(|row| (share(row - star.y_px), (row - star.y_px) * share(row - star.y_px)))
            .fold((0.0, 0.0), |(a, b), (c, d)| (a + c, b + d));
        assert!((mass.y_px - shift).abs() < 2e-3 && mass.x_px.abs() < 2e-3, "{} for {shift} at row {}", mass.y_px, star.y_px);
        assert!((mass.flux_e / star.electrons - flux).abs() < 2e-3, "{} for {flux}", mass.flux_e / star.electrons);
        if shift < 1e-6 {
            assert!(fit.y_px.abs() < 2e-3, "{} at row {}", fit.y_px, star.y_px);
            away += 1;
        } else {
            at_line += 1;
        }
    }
    assert!(at_line >= 5 && away >= 35, "{at_line} at the line, {away} away");
    let (cosine, _) = beside("amplifier step, centre of mass", &mass, &all, |star| by_formula("amplifier-step", star, 8.0));
    assert!(cosine < 0.5, "{cosine}"); // that of a few stars at the line
    page_says(&displacement("amplifier-step").unwrap().page(), "a gain alone moves only stars whose light lies on both sides of the line");
}
