//! Scenes whose camera joins pixels: the same light on the same places, the noise and the full pixel of what is joined, what is refused.

use boresight::catalog::Catalog;
use boresight::imaging::{Backend, compare_counts};
use boresight::render::Renderer;
use boresight::scene::Scene;

use crate::detector::{expected, parse, small_scene};

/// A `[camera.binning]`.
fn table(factor: usize, method: &str, place: &str) -> String {
    format!("[camera.binning]\nfactor = {factor}\nmethod = \"{method}\"\nplace = \"{place}\"\n")
}

#[test]
fn bad_binning_gets_one_clear_sentence() {
    for (detector, more, parts) in [
        ("", table(1, "sum", "on-chip"), &["camera.binning.factor = 1", "2, 3 or 4"][..]),
        ("", table(2, "sum", "digital"), &["camera.binning.factor = 2", "beyond 16 bits"][..]),
        ("bits = 14", table(3, "sum", "digital"), &["beyond 16 bits"][..]),
        ("", table(2, "sum", "nowhere"), &["line "][..]),
        ("psf_sigma_px = 15.0", table(4, "sum", "on-chip"), &["psf.sigma_px = 60", "own pixels"][..]),
    ] {
        let text = small_scene(detector, &more);
        let text = if detector.starts_with("psf") { text.replacen("psf_sigma_px = 1.1\n", "", 1) } else { text };
        let message = Scene::parse("scene.toml", &text).unwrap_err().to_string();
        assert!(message.starts_with("scene.toml: ") && !message.contains('\n'), "{message}");
        for part in parts {
            assert!(message.contains(part), "{part:?} is not in: {message}");
        }
    }
    parse("bits = 12", &table(3, "sum", "digital"));
    parse("", &table(4, "mean", "digital"));
}

/// (Behind a rolling shutter the rows that are joined have times of their own.) A Gaussian, an elliptic one, tables, a camera that turns behind a rolling shutter and a ghost: the light in a joined pixel is that in a pixel of its size.
#[test]
fn joined_pixels_see_the_light_of_their_area() {
    let moffat = "[psf]\nkind = \"moffat\"\nparameters = { fwhm_px = 2.6, beta = 3.0 }\nreach_px = 12\n";
    let elliptic = "[psf]\nkind = \"elliptic-gaussian\"\nparameters = { sigma_major_px = 1.6, sigma_minor_px = 1.0, angle_deg = 20.0 }\n";
    let glow = "[[effects]]\nid = \"starlight\"\n";
    let ghost = "[[ghosts]]\nscale = -0.8\nfraction = 1e-2\nradius_px = 9.0\nobstruction = 0.3\n[[streaks]]\nkind = \"satellite\"\nframe = 0\n\
                 start_px = [-10.0, 12.0]\nend_px = [70.0, 60.0]\nelectrons = 1e5\n[cosmic_rays]\nexpected_per_s = 60.0\n";
    for (more, turn, tolerance) in [
        ("", "", 2e-6),
        (glow, "", 2e-6),
        (ghost, "", 3e-5),
        (elliptic, "", 2e-6),
        (moffat, "", 2e-4),
        ("", "rate_deg_s = [0.3, 0.2, 0.0]\n", 1e-4),
    ] {
        let scene = |binning: &str| {
            let text = small_scene("", &format!("{turn}{binning}{more}"));
            let text = if turn.is_empty() { text } else { text.replacen("width_px = 96", "width_px = 96\nline_time_us = 50.0", 1) };
            Scene::parse("scene.toml", &text).unwrap()
        };
        let plain = expected(&scene(""), Backend::Cpu).unwrap();
        let brightest = plain.iter().fold(0.0_f32, |most, electrons| most.max(*electrons));
        for factor in [2, 3] {
            let joined = expected(&scene(&table(factor, "sum", "on-chip")), Backend::Cpu).unwrap();
            assert_eq!(joined.len(), plain.len());
            let worst = joined.iter().zip(&plain).map(|(a, b)| (a - b).abs() / brightest).fold(0.0, f32::max);
            assert!(worst < tolerance, "{factor}: {worst} of the brightest pixel with {more:?} {turn}");
        }
    }
}

/// Mean and variance of dark frames are those of the pixel that is declared, for charge and counts, sums and means; and a full pixel has its count.
#[test]
fn joined_pixels_are_what_the_recording_declares() {
    for (method, place) in [("sum", "on-chip"), ("mean", "on-chip"), ("sum", "digital"), ("mean", "digital")] {
        let detector = "bits = 12\n";
        let dark = |stars: bool| {
            let text = small_scene(detector, &table(2, method, place)).replacen("gain_e_per_dn = 2.0", "gain_e_per_dn = 0.5", 1);
            let text = text.replacen("full_well_e = 1.0e5", "full_well_e = 1500.0", 1);
            let sky = format!(
                "[sky]\nbackground_e_per_px_s = 0.0\nfaintest_magnitude = {}\nphysics = \"none\"\n",
                if stars { 7.0 } else { -9.0 }
            );
            let start = text.find("[sky]").unwrap();
            let frames = &text[text.find("[[frames]]").unwrap()..];
            Scene::parse("scene.toml", &format!("{}{sky}{frames}", &text[..start])).unwrap()
        };
        let scene = dark(false);
        let declared = scene.detector.joined(scene.binning);
        let counts = Renderer::new(&scene, Catalog::embedded(), Backend::Cpu).unwrap().render(0).unwrap().pixels_dn;
        assert_eq!(counts.len(), 96 * 80);
        let pixels = counts.len() as f64;
        let mean = counts.iter().map(|count| f64::from(*count)).sum::<f64>() / pixels;
        let variance = counts.iter().map(|count| (f64::from(*count) - mean).powi(2)).sum::<f64>() / pixels;
        // Rounding adds 1/12 for each step of the converter, and one more for a mean of counts.
        let rounding = match (method, place) {
            (_, "on-chip") => 1.0,
            ("sum", _) => 4.0,
            _ => 0.25 + 1.0,
        } / 12.0;
        let expected = (declared.read_noise_e / declared.gain_e_per_dn).powi(2) + rounding;
        assert!((variance / expected - 1.0).abs() < 5.0 * (2.0 / pixels).sqrt(), "{method} {place}: {variance} for {expected}");
        // A mean of four counts that is rounded half up is an eighth of a count too high.
        let bias = declared.bias_dn + if (method, place) == ("mean", "digital") { 0.125 } else { 0.0 };
        assert!((mean - bias).abs() < 5.0 * (expected / pixels).sqrt(), "{method} {place}: {mean} for {bias}");
        let scene = dark(true);
        let frame = Renderer::new(&scene, Catalog::embedded(), Backend::Cpu).unwrap().render(0).unwrap();
        let most = frame.pixels_dn.iter().max().unwrap();
        // The sum of four pixels under the brightest star is beyond the converter; their mean is not, nor is any of them.
        let is_cut = (method, place) == ("sum", "on-chip");
        assert!(f64::from(*most) <= declared.full_pixel_dn(), "{method} {place}: {most}");
        assert_eq!(f64::from(*most) == declared.full_pixel_dn(), is_cut, "{method} {place}: {most}");
        assert_eq!(frame.stars.iter().any(|star| star.saturated), is_cut, "{method} {place}");
        assert!(frame.stars.iter().all(|star| star.x_pixels_px.is_none_or(|shift_px| shift_px == 0.0)));
    }
}

/// Stages in both halves of the chain, on both sides: the same counts but for steps of chance; the same bytes for any number of threads.
#[test]
fn joined_frames_agree_on_both_sides() {
    let effects = "[[effects]]\nid = \"prnu\"\nparameters = { relative = 0.02 }\n[[effects]]\nid = \"banding\"\nparameters = { row_sigma_e = 3.0 }\n\
                   [[effects]]\nid = \"jpeg\"\n";
    for (factor, method, place) in [(2, "sum", "on-chip"), (3, "mean", "digital")] {
        let scene = parse("bits = 12", &format!("{}{effects}", table(factor, method, place)));
        let rendered = |backend: Backend, threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let renderer =
                    Renderer::new(&scene, Catalog::embedded(), backend).inspect_err(|error| println!("skipped: {error}")).ok()?;
                let frame = renderer.with_masks(true).with_clean(true).render(0).unwrap();
                assert_eq!((frame.mask.unwrap().len(), frame.clean_e.unwrap().len()), (96 * 80, 96 * 80));
                Some(frame.pixels_dn)
            })
        };
        let on_cpu = rendered(Backend::Cpu, 1).unwrap();
        assert_eq!(rendered(Backend::Cpu, 2).unwrap(), on_cpu);
        let Some(on_gpu) = rendered(Backend::Gpu, 2) else { return };
        let (differing, largest) = compare_counts(&on_gpu, &on_cpu);
        println!("{factor} {method} {place}: {differing} differ, by at most {largest} DN");
        // A frequency of compression that is rounded the other way changes a block of 64.
        assert!(differing as f64 <= 2e-2 * on_cpu.len() as f64, "{differing} of {}, by up to {largest} DN", on_cpu.len());
    }
}
