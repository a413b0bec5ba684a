//! Light of the sky between the stars: from the models to the pixels.

use boresight::imaging::{EffectSetting, Exposure, ImagingError, SplitLimits, Stage, StarImage};

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
        let lit = Exposure { sky_e: &sky_e, ..exposure(&stars, 1) };
        let twin = cpu(&config);
        let of_stars = twin.electrons_after(None, &exposure(&stars, 1)).unwrap();
        let on_cpu = twin.electrons_after(None, &lit).unwrap();
        for ((both, stars), sky) in on_cpu.iter().zip(&of_stars).zip(&sky_e) {
            assert!((both - (stars + sky)).abs() <= 1e-5 * both.abs() + 1e-6, "{both} for {stars} + {sky}");
        }
        let dark = twin.electrons_after(None, &Exposure { sky_e: &sky_e, ..exposure(&[], 1) }).unwrap();
        assert_eq!(dark, sky_e);
        // Veiling glare spreads the light of the sky with that of the stars and loses none.
        let total = |frame: &[f32]| frame.iter().map(|value| f64::from(*value)).sum::<f64>();
        let veiled = twin.expected_electrons(&Exposure { sky_e: &sky_e, ..exposure(&[], 1) }).unwrap();
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
    let stars: [StarImage; 0] = [];
    for sky_e in [vec![1.0; 199], vec![f32::NAN; 200]] {
        let error = imager.expected_electrons(&Exposure { sky_e: &sky_e, ..exposure(&stars, 0) }).unwrap_err();
        assert!(matches!(error, ImagingError::BadSky { expected: 200, .. }), "{error}");
    }
}
