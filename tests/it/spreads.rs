//! Plane point spreads: GPU and CPU put the same light on the pixels, and the right light.

use boresight::effects::optics::disc_psf;
use boresight::effects::optics::elliptic_gaussian_psf::{covariance_px2, shape};
use boresight::effects::optics::sampled_psf::{self, SampledImage};
use boresight::effects::optics::tables::{AtlasBuilder, Grid, IMAGE_KINDS, ImageKind, PixelResponse, image_kind, transform};
use boresight::effects::page_of;
use boresight::effects::pixel::{Atlas, PLANE_SPREADS, Psf2d, Psf2dStar};
use boresight::imaging::{FrameExposure, ImagingConfig, PlacedStar, PlaneLight, PointSource, SplitLimits, collect_plane_program};

use nalgebra::Complex;

use crate::house::root;
use crate::twins::{beyond_tolerance, cpu, gpu};

fn config(width_px: usize, height_px: usize) -> ImagingConfig {
    ImagingConfig { width_px, height_px, seed: 1, point_spread: "gaussian_psf".to_owned(), effects: vec![] }
}

/// Points of light of 10² to 10⁶ electrons over and around a frame, some of them sheared.
fn points(count: usize, width: usize, height: usize) -> Vec<PointSource> {
    let turn = |index: usize, ratio: f64| (index as f64 * ratio).fract();
    (0..count)
        .map(|i| {
            let image = PlacedStar {
                x_px: (width as f64 + 20.0) * turn(i, 0.754_877_666) - 10.0,
                y_px: (height as f64 + 20.0) * turn(i, 0.569_840_291) - 10.0,
                electrons: 10.0_f64.powf(2.0 + 4.0 * turn(i, 0.381_966_011)),
                sigma_px: 0.5 + 1.5 * turn(i, 0.22),
            };
            let shear = if i % 3 == 0 { [0.0; 2] } else { [0.02 * turn(i, 0.13) - 0.01, 0.02 * turn(i, 0.71) - 0.01] };
            PointSource { shear, ..PointSource::round(&image, 14) }
        })
        .collect()
}

/// 1e-6 of the brightest point whose square holds the pixel.
fn floor_e(deposits: &[PointSource], width: usize, height: usize) -> Vec<f64> {
    let mut floor = vec![0.0_f64; width * height];
    for deposit in deposits {
        let reach = f64::from(deposit.reach_px) + 1.0;
        for (i, floor) in floor.iter_mut().enumerate() {
            if ((i % width) as f64 - deposit.x_px).abs() < reach && ((i / width) as f64 - deposit.y_px).abs() < reach {
                *floor = floor.max(1e-6 * deposit.electrons);
            }
        }
    }
    floor
}

fn light<'a>(spread: &'static dyn Psf2d, atlas: &'a Atlas, deposits: &'a [PointSource]) -> [PlaneLight<'a>; 1] {
    [PlaneLight { spread, atlas, deposits }]
}

const NOTHING: FrameExposure<'static> = FrameExposure { stars: &[], sky_e: &[], exposure_s: 1.0, frame_index: 0, temperature_c: None };

/// The points with what a spread needs besides their width.
fn prepared(spread: &dyn Psf2d, mut deposits: Vec<PointSource>) -> (Atlas, Vec<PointSource>) {
    let mut atlas = Atlas::default();
    match spread.id() {
        "elliptic_gaussian_psf" => {
            for (i, deposit) in deposits.iter_mut().enumerate() {
                (deposit.sigma_px, deposit.shape) = shape(covariance_px2(1.3, 0.4 + 0.8 * deposit.sigma_px, i as f64));
            }
        }
        "disc_psf" => {
            for deposit in &mut deposits {
                let radius = 4.0 + 4.0 * deposit.sigma_px;
                (deposit.sigma_px, deposit.shape) = (1.0, disc_psf::shape(radius, 0.3 * radius));
            }
        }
        "atlas_psf" => {
            let grid = Grid::new(0.6, 12);
            let mut builder = AtlasBuilder::new(grid, 12);
            for parameters in [[1.4, 2.5], [1.6, 4.0], [2.2, 3.0]] {
                let table = builder.table(image_kind("moffat").unwrap().transfer(&parameters, &grid), &PixelResponse::default());
                builder.add(&table);
            }
            atlas = builder.finish();
            for (i, deposit) in deposits.iter_mut().enumerate() {
                let share = (i % 7) as f32 / 7.0;
                deposit.nodes[0] = ((i % 3) as u32, 1.0 - 0.5 * share);
                deposit.nodes[1] = (((i + 1) % 3) as u32, 0.25 * share);
                // Eight tables use both halves of the list.
                if i % 5 == 0 {
                    deposit.nodes = std::array::from_fn(|k| ((k % 3) as u32, 0.125));
                }
            }
        }
        _ => {}
    }
    (atlas, deposits)
}

/// With work split in every way, and with the proof that the comparison can fail.
#[test]
fn every_plane_spread_agrees_with_its_twin() {
    let (width, height) = (203, 119);
    let config = config(width, height);
    for spread in PLANE_SPREADS {
        let (atlas, deposits) = prepared(*spread, points(150, width, height));
        let Some(on_gpu) = gpu("every_plane_spread_agrees_with_its_twin", &config, SplitLimits::default()) else { return };
        let planes = light(*spread, &atlas, &deposits);
        let expected = cpu(&config).electrons_after_with(None, &NOTHING, &planes).unwrap();
        let found = on_gpu.electrons_after_with(None, &NOTHING, &planes).unwrap();
        let floor = floor_e(&deposits, width, height);
        assert_eq!(beyond_tolerance(&found, &expected, &floor), 0, "{}", spread.id());
        let total: f64 = found.iter().map(|e| f64::from(*e)).sum();
        assert!(total > 1e6, "{}: {total} electrons", spread.id());
        let mut sheared_less = deposits.clone();
        for deposit in &mut sheared_less {
            deposit.shear = [0.0; 2];
        }
        let other = on_gpu.electrons_after_with(None, &NOTHING, &light(*spread, &atlas, &sheared_less)).unwrap();
        assert!(beyond_tolerance(&other, &expected, &floor) > 100, "{}: a missing shear is not seen", spread.id());
        for limits in [
            SplitLimits { entries_per_dispatch: 2, buffer_bytes: 128 << 20 },
            SplitLimits { entries_per_dispatch: 60_000, buffer_bytes: 9000 },
        ] {
            let split = gpu("every_plane_spread_agrees_with_its_twin", &config, limits).expect("there was an adapter before");
            assert_eq!(split.electrons_after_with(None, &NOTHING, &planes).unwrap(), found, "{}, {limits:?}", spread.id());
        }
    }
}

/// Without shear and with a round width the plane Gaussian is the separable one.
#[test]
fn the_plane_gaussian_is_the_separable_one() {
    let config = config(90, 80);
    let mut deposits = points(60, 90, 80);
    for deposit in &mut deposits {
        deposit.shear = [0.0; 2];
    }
    let stars: Vec<PlacedStar> =
        deposits.iter().map(|d| PlacedStar { x_px: d.x_px, y_px: d.y_px, electrons: d.electrons, sigma_px: d.sigma_px }).collect();
    let atlas = Atlas::default();
    let plane = cpu(&config).electrons_after_with(None, &NOTHING, &light(PLANE_SPREADS[0], &atlas, &deposits)).unwrap();
    let separable = cpu(&config).electrons_after(None, &FrameExposure { stars: &stars, ..NOTHING }).unwrap();
    let off = plane.iter().zip(&separable).filter(|(a, b)| (**a - **b).abs() > 1e-6 * 1e6).count();
    assert_eq!(off, 0);
}

#[test]
fn plane_spreads_have_their_file_their_shader_and_their_page() {
    for spread in PLANE_SPREADS {
        let (id, source, wgsl) = (spread.id(), spread.source(), spread.wgsl());
        let code = std::fs::read_to_string(root().join(format!("src/effects/optics/{id}.rs"))).unwrap();
        assert!(code.starts_with(source) && source.starts_with("//!"), "{id} shows the page of another");
        assert_eq!(std::fs::read_to_string(root().join(format!("shaders/{id}.wgsl"))).unwrap(), wgsl);
        assert!(wgsl.contains(&format!("fn {id}(")) && code.contains(&format!("fn {id}(")), "the twins of {id} have other names");
        let page = page_of(source);
        crate::common::check_page(id, &page);
        for parameter in spread.parameters() {
            assert!(page.contains(&format!("`{}`", parameter.name)), "the page of {id} is silent about {}", parameter.name);
        }
        let program = collect_plane_program(*spread);
        let module = naga::front::wgsl::parse_str(&program).unwrap_or_else(|error| panic!("{}", error.emit_to_string(&program)));
        naga::valid::Validator::new(naga::valid::ValidationFlags::all(), naga::valid::Capabilities::empty())
            .validate(&module)
            .unwrap_or_else(|error| panic!("{}", error.emit_to_string(&program)));
        let star = module.types.iter().find_map(|(_, ty)| match &ty.inner {
            naga::TypeInner::Struct { span, .. } if ty.name.as_deref() == Some("Star") => Some(*span as usize),
            _ => None,
        });
        assert_eq!(star, Some(size_of::<Psf2dStar>()));
    }
}

/// A star of one electron in the middle of a frame, from a table of this image.
fn image_of(atlas: &Atlas, reach_px: u16, x_px: f64, y_px: f64, width: usize) -> Vec<f64> {
    let star = PlacedStar { x_px, y_px, electrons: 1.0, sigma_px: 1.0 };
    let mut deposit = PointSource::round(&star, reach_px + 1);
    deposit.nodes[0] = (0, 1.0);
    let spread = PLANE_SPREADS.iter().find(|spread| spread.id() == "atlas_psf").unwrap();
    let image = cpu(&config(width, width)).electrons_after_with(None, &NOTHING, &light(*spread, atlas, &[deposit])).unwrap();
    image.into_iter().map(f64::from).collect()
}

fn table(kind: &dyn ImageKind, parameters: &[f64], reach_px: usize, pixel: &PixelResponse) -> Atlas {
    let grid = Grid::new(kind.smooth_px(parameters), reach_px);
    let mut builder = AtlasBuilder::new(grid, reach_px);
    let table = builder.table(kind.transfer(parameters, &grid), pixel);
    builder.add(&table);
    builder.finish()
}

/// ∫ of a density over the square pixel at (dx, dy): Gauss's rule of four nodes on 4 × 4 parts.
fn over_pixel(dx: f64, dy: f64, density: &dyn Fn(f64, f64) -> f64) -> f64 {
    const RULE: [[f64; 2]; 4] = [
        [-0.861_136_311_594_052_6, 0.173_927_422_568_726_9],
        [-0.339_981_043_584_856_3, 0.326_072_577_431_273_1],
        [0.339_981_043_584_856_3, 0.326_072_577_431_273_1],
        [0.861_136_311_594_052_6, 0.173_927_422_568_726_9],
    ];
    let nodes: Vec<[f64; 2]> =
        (0..4).flat_map(|part| RULE.map(|[node, weight]| [(f64::from(part) + 0.5 + 0.5 * node) / 4.0 - 0.5, weight / 4.0])).collect();
    nodes.iter().flat_map(|[x, a]| nodes.iter().map(move |[y, b]| a * b * density(dx + x, dy + y))).sum()
}

/// The transform at 1, 2, 3 … cycles a pixel along x and along y of what a table holds of an image: its light fades over the last fifth of the
/// reach, and what is left counts as the whole, with its centre at the star's place.
fn harmonics(kind: &dyn ImageKind, parameters: &[f64], reach_px: usize) -> [Vec<Complex<f64>>; 2] {
    let grid = Grid::new(kind.smooth_px(parameters), reach_px);
    let mut image = kind.transfer(parameters, &grid);
    transform(&mut image, grid.side, true);
    let place = |i: usize| [grid.place_px(i % grid.side), grid.place_px(i / grid.side)];
    let reach = reach_px as f64;
    let left = |centre: [f64; 2], i: usize| {
        let [x, y] = place(i);
        let share = ((x - centre[0]).hypot(y - centre[1]) / reach - 0.8) / 0.2;
        image[i].re * (0.5 * std::f64::consts::PI * share.clamp(0.0, 1.0)).cos().powi(2)
    };
    let mut centre = [0.0; 2];
    for _ in 0..40 {
        let mut sums = [0.0; 3];
        for i in 0..image.len() {
            let (light, [x, y]) = (left(centre, i), place(i));
            sums = [sums[0] + light, sums[1] + light * x, sums[2] + light * y];
        }
        let before = std::mem::replace(&mut centre, [sums[1] / sums[0], sums[2] / sums[0]]);
        if (centre[0] - before[0]).hypot(centre[1] - before[1]) < 1e-9 {
            break;
        }
    }
    let total: f64 = (0..image.len()).map(|i| left(centre, i)).sum();
    [0, 1].map(|axis| {
        let at = |k: i32| {
            let term = |i: usize| {
                let turn = -std::f64::consts::TAU * f64::from(k) * (place(i)[axis] - centre[axis]);
                Complex::from_polar(left(centre, i) / total, turn)
            };
            (0..image.len()).map(term).sum::<Complex<f64>>()
        };
        (1..5).map(at).collect()
    })
}

/// How far pixels shift the centre of what they sample, by Poisson's sum formula (Alexander and Ng 1991): nothing where the image has no
/// light at whole cycles a pixel.
fn sampling_shift_px(place_px: f64, harmonics: &[Complex<f64>]) -> f64 {
    let shift = |(k, light): (i32, &Complex<f64>)| {
        let turn = std::f64::consts::TAU * f64::from(k);
        let (sine, cosine) = (turn * place_px).sin_cos();
        (if k % 2 == 0 { 2.0 } else { -2.0 }) / turn * (light.re * sine - light.im * cosine)
    };
    (1..).zip(harmonics).map(shift).sum()
}

/// Flux and centre of every kind of image do not depend on where the star stands in its pixel.
#[test]
fn images_from_tables_keep_flux_and_centre() {
    let mut tried: Vec<(&dyn ImageKind, Vec<f64>)> =
        IMAGE_KINDS.iter().map(|kind| (*kind, kind.parameters().iter().map(|spec| spec.typical).collect())).collect();
    let zernike = image_kind("zernike").unwrap();
    let mut coma = vec![0.0; zernike.parameters().len()];
    (coma[0], coma[1], coma[2], coma[5], coma[6], coma[9]) = (1.1, 0.25, 0.1, 0.08, -0.06, 0.05);
    tried.push((zernike, coma));
    // Light at a whole cycle a pixel and beyond: pixels show these images with a centre that follows the phase.
    let airy = image_kind("airy").unwrap();
    tried.extend([vec![1.05, 0.0], vec![0.7, 0.0], vec![0.7, 0.35], vec![0.4, 0.0]].map(|parameters| (airy, parameters)));
    for (kind, parameters) in tried {
        let reach = kind.reach_px(&parameters);
        let atlas = table(kind, &parameters, reach, &PixelResponse::default());
        let sampled = harmonics(kind, &parameters, reach);
        let width = 2 * reach + 9;
        let middle = (width / 2) as f64;
        let (mut fluxes, mut worst) = (Vec::new(), 0.0_f64);
        for k in 0..12 {
            let (x, y) = (middle + (f64::from(k) * 0.381_966).fract() - 0.5, middle + (f64::from(k) * 0.754_877).fract() - 0.5);
            let image = image_of(&atlas, reach as u16, x, y, width);
            let flux: f64 = image.iter().sum();
            let moment = |along: &dyn Fn(usize) -> f64| image.iter().enumerate().map(|(i, e)| e * along(i)).sum::<f64>() / flux;
            let expected = [x + sampling_shift_px(x, &sampled[0]), y + sampling_shift_px(y, &sampled[1])];
            let off = (moment(&|i| (i % width) as f64) - expected[0]).hypot(moment(&|i| (i / width) as f64) - expected[1]);
            worst = worst.max(off);
            fluxes.push(flux);
        }
        let (low, high) = fluxes.iter().fold((f64::INFINITY, 0.0_f64), |(low, high), flux| (low.min(*flux), high.max(*flux)));
        println!("{} {parameters:?}: centre within {worst:.1e} px, flux {high:.6}, even within {:.1e}", kind.id(), high - low);
        assert!(worst < 1e-5 && high - low < 1e-5, "{}: {worst:.1e} px, flux {low} … {high}", kind.id());
        assert!(high < 1.0 + 1e-6 && low > 0.95, "{}: {low} of the light", kind.id());
    }
}

/// Single pixels against sums over densities that are worked out in another way.
#[test]
fn images_from_tables_are_right_pixel_by_pixel() {
    const CELLS: usize = 100;
    let (x, y) = (30.27, 29.61);
    let check = |name: &str, atlas: &Atlas, reach: u16, density: &dyn Fn(f64, f64) -> f64, tolerance: f64| {
        let image = image_of(atlas, reach, x, y, 60);
        let mut worst = 0.0_f64;
        for (column, row) in [(30, 30), (31, 30), (30, 29), (29, 31), (33, 28), (36, 30), (24, 33)] {
            let expected = over_pixel(f64::from(column) - x, f64::from(row) - y, density);
            worst = worst.max((image[(row * 60 + column) as usize] - expected).abs());
        }
        println!("{name}: pixels within {worst:.1e} of the light");
        assert!(worst < tolerance, "{name}: {worst:.1e}");
    };
    let plain = PixelResponse::default();
    for (fwhm, beta) in [(1.2_f64, 2.5), (2.2, 3.5), (4.0, 4.8)] {
        let alpha = 0.5 * fwhm / (2.0_f64.powf(1.0 / beta) - 1.0).sqrt();
        let density =
            |x: f64, y: f64| (beta - 1.0) / (std::f64::consts::PI * alpha * alpha) * (1.0 + (x * x + y * y) / (alpha * alpha)).powf(-beta);
        check(&format!("moffat {fwhm} {beta}"), &table(image_kind("moffat").unwrap(), &[fwhm, beta], 22, &plain), 22, &density, 1e-5);
    }
    // A pupil of 100 × 100 points, with a hole and a bent wavefront, summed up at every point of the image.
    let zernike = image_kind("zernike").unwrap();
    for waves in [[0.0, 0.0], [0.15, 0.1]] {
        let (lambda_n, hole) = (1.4, 0.3);
        let cell = |k: usize| (k as f64 + 0.5) / CELLS as f64 - 0.5;
        let pupil: Vec<[f64; 3]> = (0..CELLS * CELLS)
            .map(|k| [cell(k % CELLS), cell(k / CELLS)])
            .filter(|[u, v]| (0.5 * hole..=0.5).contains(&u.hypot(*v)))
            .map(|[u, v]| {
                let r2 = 4.0 * (u * u + v * v);
                // Defocus and astigmatism, which leave the centre of the light where it is.
                [u, v, waves[0] * 3.0_f64.sqrt() * (2.0 * r2 - 1.0) + waves[1] * 6.0_f64.sqrt() * 8.0 * u * v]
            })
            .collect();
        let density = |x: f64, y: f64| {
            let (mut re, mut im) = (0.0, 0.0);
            for [u, v, wave] in &pupil {
                let (sine, cosine) = (std::f64::consts::TAU * (wave - (x * u + y * v) / lambda_n)).sin_cos();
                (re, im) = (re + cosine, im + sine);
            }
            (re * re + im * im) / (pupil.len() as f64 * (CELLS * CELLS) as f64 * lambda_n * lambda_n)
        };
        let image = {
            let mut parameters = vec![0.0; zernike.parameters().len()];
            (parameters[0], parameters[1], parameters[2], parameters[3]) = (lambda_n, hole, waves[0], waves[1]);
            image_of(&table(zernike, &parameters, 27, &plain), 27, x, y, 60)
        };
        let airy = image_of(&table(image_kind("airy").unwrap(), &[lambda_n, hole], 27, &plain), 27, x, y, 60);
        for (column, row) in [(30, 30), (31, 29), (33, 30)] {
            let expected = over_pixel(f64::from(column) - x, f64::from(row) - y, &density);
            let at = (row * 60 + column) as usize;
            println!("zernike {waves:?}, pixel {column} {row}: {} for {expected}", image[at]);
            // The reference itself has a ragged pupil of few points.
            assert!((image[at] - expected).abs() < 3e-4, "{waves:?}: {} instead of {expected}", image[at]);
            if waves == [0.0, 0.0] {
                assert!((image[at] - airy[at]).abs() < 3e-5, "without aberrations: {} and {}", image[at], airy[at]);
            }
        }
    }
}

/// A pixel that is more sensitive on one side and in its middle, and an image given point by point, both against closed sums.
#[test]
fn responses_of_pixels_and_sampled_images() {
    let gaussian =
        |sigma: f64| move |x: f64, y: f64| (-0.5 * (x * x + y * y) / (sigma * sigma)).exp() / (std::f64::consts::TAU * sigma * sigma);
    let pixel = PixelResponse { cosine: [0.2, -0.1], slope: [0.15, 0.05], diffusion_px: 0.3, is_in_image: false };
    let atlas = table(image_kind("gaussian").unwrap(), &[0.5], 8, &pixel);
    let (x, y) = (20.3, 19.8);
    let image = image_of(&atlas, 8, x, y, 40);
    let wider = gaussian((0.25_f64 + 0.09).sqrt());
    for (column, row) in [(20, 20), (21, 20), (19, 19), (20, 18)] {
        let (dx, dy) = (f64::from(column) - x, f64::from(row) - y);
        let weight = |u: f64, v: f64| {
            let along = |axis: usize, u: f64| 1.0 + pixel.cosine[axis] * (std::f64::consts::TAU * u).cos() + pixel.slope[axis] * u;
            along(0, u) * along(1, v)
        };
        // Diffusion of the charge is worked out as diffusion of the light: the pixel then collects it.
        let expected = over_pixel(dx, dy, &|px, py| wider(px, py) * weight(px - dx, py - dy));
        let found = image[(row * 40 + column) as usize];
        assert!((found - expected).abs() < 5e-6, "{column} {row}: {found} instead of {expected}");
    }
    let points = 5;
    let side = 91;
    let value = |k: usize| (k as f64 - 45.0) / points as f64;
    let values = (0..side * side).map(|i| (1000.0 * gaussian(0.8)(value(i % side) - 0.13, value(i / side) + 0.07)) as f32).collect();
    let sampled = SampledImage { width: side, height: side, values, points_per_px: points };
    let (grid, finer) = sampled.grid(8);
    let mut builder = AtlasBuilder::new(grid, 8);
    let table = builder.table(sampled.transfer(&grid, finer), &PixelResponse::default());
    builder.add(&table);
    let image = image_of(&builder.finish(), 8, x, y, 40);
    for (column, row) in [(20, 20), (21, 20), (19, 19), (22, 18)] {
        let expected = over_pixel(f64::from(column) - x, f64::from(row) - y, &gaussian(0.8));
        let found = image[(row * 40 + column) as usize];
        assert!((found - expected).abs() < 5e-6, "{column} {row}: {found} instead of {expected}");
    }
}

#[test]
fn kinds_of_images_have_their_pages() {
    let pages = IMAGE_KINDS.iter().map(|kind| (kind.id(), kind.source(), kind.parameters()));
    for (id, source, parameters) in pages.chain([("sampled", sampled_psf::source(), &[][..])]) {
        let page = page_of(source);
        crate::common::check_page(id, &page);
        for parameter in parameters {
            assert!(page.contains(&format!("`{}`", parameter.name)), "the page of {id} is silent about {}", parameter.name);
            assert!((parameter.range.0..=parameter.range.1).contains(&parameter.typical), "{id}: {}", parameter.name);
        }
    }
}
