//! Damaged files never panic: truncated, with bytes changed, or both.

use boresight::recording::{OpenOptions, Recording};
use image::{DynamicImage, ImageFormat};
use proptest::prelude::*;

use super::made::{Folder, counts, encoded, fits, png};

const MANIFEST: &str = "format = \"star-recording/1\"\nstars = \"stars.csv\"\n[camera]\nwidth_px = 12\nheight_px = 10\nk1 = 1e-9\n[site]\n\
latitude_deg = 5.0\nlongitude_deg = 4.4\n[[frames]]\ntime_utc = \"2026-03-01T22:15:07.250Z\"\nrate_deg_s = [0.0, 0.05, 0.0]\n[[frames]]\nheater = 1\n";
const STARS: &str = "frame,x_px,y_px,sigma_x_px,sigma_y_px,cov_xy_px2,hip\n0,1.5,2.5,0.1,0.1,0.001,32349\n1,3,4,,,,\n";

/// Small valid files of every kind.
fn files() -> Vec<(&'static str, Vec<u8>)> {
    let colour = DynamicImage::ImageRgb8(image::RgbImage::from_fn(16, 12, |x, y| image::Rgb([x as u8, y as u8, (x * y) as u8])));
    vec![
        ("a.fits", include_bytes!("../../fixtures/astropy_u16.fits").to_vec()),
        ("a.fit", fits(&["BITPIX  = 8", "NAXIS   = 3", "NAXIS3  = 1"], &counts())),
        ("a.png", png(12, 10)),
        ("a.tiff", encoded(&colour, ImageFormat::Tiff)),
        ("a.bmp", encoded(&colour, ImageFormat::Bmp)),
        ("a.jpg", encoded(&colour, ImageFormat::Jpeg)),
        ("recording.toml", MANIFEST.as_bytes().to_vec()),
        ("stars.csv", STARS.as_bytes().to_vec()),
    ]
}

/// Opens and reads all there is; whatever comes out, it is a value.
fn read_all(folder: &Folder) {
    for keep_going in [false, true] {
        if let Ok(recording) = Recording::open_with(&[folder.root()], OpenOptions { keep_going, ..OpenOptions::default() }) {
            for frame in 0..recording.frames.len() {
                if let Ok(loaded) = recording.load_frame(frame) {
                    assert_eq!(loaded.pixels_dn.len(), loaded.width_px * loaded.height_px);
                    assert!(loaded.pixels_dn.iter().all(|pixel| pixel.is_finite()));
                }
            }
            let _ = (recording.nominal_camera(), recording.common_size());
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 600, failure_persistence: Some(crate::common::regressions()), ..ProptestConfig::default() })]

    #[test]
    fn damaged_files_give_an_error_or_a_frame(
        which in 0_usize..8,
        keep in prop_oneof![Just(1.0), 0.0..1.0_f64],
        // the heads of files are where the traps are
        changes in prop::collection::vec((prop_oneof![0.0..1.0_f64, 0.0..0.1_f64], any::<u8>()), 0..8),
    ) {
        let (name, mut bytes) = files().swap_remove(which);
        bytes.truncate((bytes.len() as f64 * keep) as usize);
        for (place, byte) in changes {
            let at = (bytes.len() as f64 * place) as usize;
            if let Some(there) = bytes.get_mut(at) {
                *there = byte;
            }
        }
        let folder = Folder::with(&[]);
        if which >= 6 {
            folder.add("recording.toml", MANIFEST.as_bytes());
            folder.add("stars.csv", STARS.as_bytes());
        }
        folder.add(name, &bytes);
        read_all(&folder);
    }

    #[test]
    fn fits_headers_of_any_numbers_give_an_error_or_a_frame(
        card in prop::sample::select(vec!["BITPIX  ", "NAXIS   ", "NAXIS1  ", "NAXIS2  ", "NAXIS3  ", "BZERO   ", "BSCALE  ", "BLANK   ", "EXPTIME ", "PCOUNT  "]),
        value in prop_oneof![any::<i64>().prop_map(|whole| whole.to_string()), any::<f64>().prop_map(|number| format!("{number:E}")), "[ -~]{0,30}"],
    ) {
        let folder = Folder::with(&[("a.fits", &fits(&[&format!("{card}= {value}")], &counts()))]);
        read_all(&folder);
    }
}
