//! Plane point spreads: GPU and CPU put the same light on the pixels, and the right light.

use boresight::effects::page_of;
use boresight::effects::pixel::{Atlas, PLANE_SPREADS, PlaneSpread, PlaneStar};
use boresight::imaging::{Deposit, Exposure, ImagingConfig, PlaneLight, SplitLimits, StarImage, collect_plane_program};

use crate::house::root;
use crate::twins::{beyond_tolerance, cpu, gpu};

fn config(width_px: usize, height_px: usize) -> ImagingConfig {
    ImagingConfig { width_px, height_px, seed: 1, point_spread: "gaussian_psf".to_owned(), effects: vec![] }
}

/// Points of light of 10² to 10⁶ electrons over and around a frame, some of them sheared.
fn points(count: usize, width: usize, height: usize) -> Vec<Deposit> {
    let turn = |index: usize, ratio: f64| (index as f64 * ratio).fract();
    (0..count)
        .map(|i| {
            let image = StarImage {
                x_px: (width as f64 + 20.0) * turn(i, 0.754_877_666) - 10.0,
                y_px: (height as f64 + 20.0) * turn(i, 0.569_840_291) - 10.0,
                electrons: 10.0_f64.powf(2.0 + 4.0 * turn(i, 0.381_966_011)),
                sigma_px: 0.5 + 1.5 * turn(i, 0.22),
            };
            let shear = if i % 3 == 0 { [0.0; 2] } else { [0.02 * turn(i, 0.13) - 0.01, 0.02 * turn(i, 0.71) - 0.01] };
            Deposit { shear, ..Deposit::round(&image, 14) }
        })
        .collect()
}

/// 1e-6 of the brightest point whose square holds the pixel.
fn floor_e(deposits: &[Deposit], width: usize, height: usize) -> Vec<f64> {
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

fn light<'a>(spread: &'static dyn PlaneSpread, atlas: &'a Atlas, deposits: &'a [Deposit]) -> [PlaneLight<'a>; 1] {
    [PlaneLight { spread, atlas, deposits }]
}

const NOTHING: Exposure<'static> = Exposure { stars: &[], exposure_s: 1.0, frame_index: 0, temperature_c: None };

/// With work split in every way, and with the proof that the comparison can fail.
#[test]
fn every_plane_spread_agrees_with_its_twin() {
    let (width, height) = (203, 119);
    let config = config(width, height);
    for spread in PLANE_SPREADS {
        let (atlas, deposits) = (Atlas::default(), points(150, width, height));
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
    let stars: Vec<StarImage> =
        deposits.iter().map(|d| StarImage { x_px: d.x_px, y_px: d.y_px, electrons: d.electrons, sigma_px: d.sigma_px }).collect();
    let atlas = Atlas::default();
    let plane = cpu(&config).electrons_after_with(None, &NOTHING, &light(PLANE_SPREADS[0], &atlas, &deposits)).unwrap();
    let separable = cpu(&config).electrons_after(None, &Exposure { stars: &stars, ..NOTHING }).unwrap();
    let off = plane.iter().zip(&separable).filter(|(a, b)| (**a - **b).abs() > 1e-6 * 1e6).count();
    assert_eq!(off, 0);
}

#[test]
fn plane_spreads_have_their_file_their_shader_and_their_page() {
    for spread in PLANE_SPREADS {
        let (id, source, wgsl) = (spread.id(), spread.source(), spread.wgsl());
        assert_eq!(std::fs::read_to_string(root().join(format!("src/effects/optics/{id}.rs"))).unwrap(), source);
        assert_eq!(std::fs::read_to_string(root().join(format!("shaders/{id}.wgsl"))).unwrap(), wgsl);
        assert!(wgsl.contains(&format!("fn {id}(")) && source.contains(&format!("fn {id}(")), "the twins of {id} have other names");
        let page = page_of(source);
        for part in
            ["**What it is.**", "**Equation.**", "**What it leaves when left out.**", "**Confused with.**", "**Neglected.**", "**Source.**"]
        {
            assert!(page.contains(part), "the page of {id} lacks {part}");
        }
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
        assert_eq!(star, Some(size_of::<PlaneStar>()));
    }
}
