//! Pictures as they were last accepted, within a tolerance: `tests/it/golden`. `BORESIGHT_ACCEPT_PICTURES=1` accepts what is drawn now.

use std::path::{Path, PathBuf};

use boresight::report::{FieldMap, ProfilePlot, ProfilePoint, Vector, VectorPanel, residual_vectors};
use image::{Rgb, RgbImage};

/// Draws a picture into a file; of the sign −1, something else.
type Draw = fn(&Path, f64);

/// The variable that accepts the pictures as they are drawn now.
const ACCEPT: &str = "BORESIGHT_ACCEPT_PICTURES";
/// Mean absolute difference of a channel, of 255: a letter that is set a little elsewhere stays below it.
const MEAN: f64 = 0.25;
/// The difference that one channel of a thousand exceeds: edges that are smoothed otherwise stay below it, a line that is gone does not.
const MAX_DIFFERENCE: u8 = 64;
/// The largest file.
const LARGEST_BYTES: u64 = 64 * 1024;

/// Mean and 99.9th percentile of the absolute difference of the channels; nothing where the sizes differ.
fn difference(expected: &RgbImage, actual: &RgbImage) -> Option<(f64, u8)> {
    if expected.dimensions() != actual.dimensions() {
        return None;
    }
    let mut off: Vec<u8> = expected.as_raw().iter().zip(actual.as_raw()).map(|(a, b)| a.abs_diff(*b)).collect();
    off.sort_unstable();
    let mean = off.iter().map(|value| f64::from(*value)).sum::<f64>() / off.len() as f64;
    Some((mean, off[off.len() * 999 / 1000]))
}

fn is_same(expected: &RgbImage, actual: &RgbImage) -> bool {
    difference(expected, actual).is_some_and(|(mean, most)| mean <= MEAN && most <= MAX_DIFFERENCE)
}

/// Expected, actual and their difference, side by side.
fn side_by_side(expected: &RgbImage, actual: &RgbImage) -> RgbImage {
    let (width, height) = (expected.width().max(actual.width()), expected.height().max(actual.height()));
    let at = |picture: &RgbImage, x, y| picture.get_pixel_checked(x, y).copied().unwrap_or(Rgb([128; 3]));
    RgbImage::from_fn(3 * width, height, |x, y| {
        let (a, b) = (at(expected, x % width, y), at(actual, x % width, y));
        match x / width {
            0 => a,
            1 => b,
            _ => Rgb([0, 1, 2].map(|channel| 255 - a.0[channel].abs_diff(b.0[channel]))),
        }
    })
}

fn opened(path: &Path) -> RgbImage {
    image::open(path).unwrap_or_else(|error| panic!("{}: {error}; {ACCEPT}=1 writes it", path.display())).into_rgb8()
}

fn golden(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("tests/it/golden/{name}.png"))
}

/// Draws a picture and holds it against the accepted one.
fn check(name: &str, draw: impl FnOnce(&Path)) {
    let (accepted, folder) = (golden(name), tempfile::tempdir().unwrap());
    let drawn = folder.path().join("drawn.png");
    draw(&drawn);
    if std::env::var_os(ACCEPT).is_some_and(|value| value == "1") {
        std::fs::create_dir_all(accepted.parent().unwrap()).unwrap();
        std::fs::copy(&drawn, &accepted).unwrap();
    }
    let size = std::fs::metadata(&accepted).map_or(0, |file| file.len());
    assert!(size <= LARGEST_BYTES, "{}: {size} bytes; draw less", accepted.display());
    let (expected, actual) = (opened(&accepted), opened(&drawn));
    if !is_same(&expected, &actual) {
        let shown = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("{name}.png"));
        side_by_side(&expected, &actual).save(&shown).unwrap();
        panic!(
            "{name}: mean and 99.9th percentile of the difference {:?}, at most ({MEAN}, {MAX_DIFFERENCE}); expected, actual and difference are in {}; {ACCEPT}=1 accepts it",
            difference(&expected, &actual),
            shown.display()
        );
    }
}

/// Residuals that turn about the middle of the frame, all of them turned round by `sign`.
fn swirl(sign: f64) -> Vec<Vector> {
    let place = |index: i32| (f64::from(index % 6) * 80.0 + 55.0, f64::from(index / 6) * 80.0 + 55.0);
    (0..36)
        .map(|index| {
            let (x_px, y_px) = place(index);
            Vector { x_px, y_px, dx_px: sign * 1e-3 * (y_px - 255.0), dy_px: -sign * 1e-3 * (x_px - 255.0), rejected: index == 7 }
        })
        .collect()
}

fn vectors(path: &Path, sign: f64) {
    let panel = |title: &str, share: f64| VectorPanel {
        title: title.to_owned(),
        vectors: swirl(sign).into_iter().map(|own| Vector { dx_px: share * own.dx_px, dy_px: share * own.dy_px, ..own }).collect(),
        told: None,
    };
    residual_vectors(path, "residuals", (512, 512), [&panel("before", 1.0), &panel("after", 0.1)]).unwrap();
}

fn map(path: &Path, sign: f64) {
    let side = 9;
    let values = (0..side * side).map(|index| (index % side) as f64 * 0.01 + (index / side) as f64 * 0.02).collect();
    let map = FieldMap {
        title: "a field".to_owned(),
        summary: "arrows that turn".to_owned(),
        values,
        side,
        unit: "px".to_owned(),
        arrows: swirl(sign),
        ..FieldMap::default()
    };
    map.write(path, (512, 512)).unwrap();
}

fn profile(path: &Path, sign: f64) {
    let bin = |index: u32| {
        let at = f64::from(index) / 8.0;
        ProfilePoint { at, mean: sign * (0.1 * at - 0.03), sigma: 0.01, model: sign * (0.09 * at - 0.03), stars: 40 }
    };
    let plot = ProfilePlot {
        title: "a profile".to_owned(),
        summary: "residuals and a line".to_owned(),
        x_label: "field radius".to_owned(),
        y_label: "residual / px".to_owned(),
        points: "displacement seen in the bin ± its standard error".to_owned(),
        counted: "stars".to_owned(),
        bins: (0..9).map(bin).collect(),
    };
    plot.write(path).unwrap();
}

#[test]
fn pictures_are_as_accepted() {
    check("residual_vectors", |path| vectors(path, 1.0));
    check("field_map", |path| map(path, 1.0));
    check("profile", |path| profile(path, 1.0));
}

/// Arrows the other way round, or a line that falls, are another picture; so is one of another size.
#[test]
fn pictures_of_something_else_are_told_apart() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("flipped.png");
    let draws: [(&str, Draw); 3] = [("residual_vectors", vectors), ("field_map", map), ("profile", profile)];
    for (name, draw) in draws {
        draw(&path, -1.0);
        let (expected, flipped) = (opened(&golden(name)), opened(&path));
        println!("{name} flipped: {:?}", difference(&expected, &flipped));
        assert!(!is_same(&expected, &flipped), "{name}: {:?}", difference(&expected, &flipped));
        assert_eq!(side_by_side(&expected, &flipped).dimensions(), (3 * expected.width(), expected.height()));
        assert!(is_same(&expected, &expected) && !is_same(&expected, &RgbImage::new(3, 3)), "{name}");
    }
}
