//! The mesh of the sky's level against frames drawn with noise, a gradient and stars that nobody finds.

use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;

use super::*;

const SIZE_PX: [usize; 2] = [320, 256];
const SKY_E: f64 = 400.0;

/// Rise of the sky at a place (in half-diagonals), as a share of its level.
type Shape = fn([f64; 2]) -> f64;

/// A frame of sky with `stars` faint stars, whose brightest pixel stands out by up to four standard deviations of the noise.
fn mesh(seed: u64, stars: usize, shape: Shape) -> SkyMesh {
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    let [width, height] = SIZE_PX;
    let half_px = 0.5 * (width as f64).hypot(height as f64);
    let mut electrons: Vec<f64> = (0..width * height)
        .map(|index| {
            let at = [(index % width) as f64 - 0.5 * (width as f64 - 1.0), (index / width) as f64 - 0.5 * (height as f64 - 1.0)];
            SKY_E * (1.0 + shape(at.map(|along| along / half_px)))
        })
        .collect();
    for _ in 0..stars {
        let place: [f64; 2] = [rng.random::<f64>() * width as f64, rng.random::<f64>() * height as f64];
        // As many as there are in the sky: four times as many at a quarter of the light.
        let flux = 12.0 * SKY_E.sqrt() * (0.02 + 0.98 * rng.random::<f64>()).powf(-0.67).min(8.0) / 8.0;
        for y in (place[1] as usize).saturating_sub(3)..(place[1] as usize + 4).min(height) {
            for x in (place[0] as usize).saturating_sub(3)..(place[0] as usize + 4).min(width) {
                let square = (x as f64 - place[0]).powi(2) + (y as f64 - place[1]).powi(2);
                electrons[y * width + x] += flux / std::f64::consts::TAU * (-0.5 * square).exp();
            }
        }
    }
    let mut count = |light: f64| -> f32 {
        let (photon, reading): (f64, f64) = (StandardNormal.sample(&mut rng), StandardNormal.sample(&mut rng));
        ((light + light.sqrt() * photon + 5.0 * reading) / 2.0 + 100.0).round() as f32
    };
    let pixels_dn = electrons.into_iter().map(&mut count).collect();
    let frame = Frame { width_px: width, height_px: height, pixels_dn, saturation_dn: 65_535.0 };
    let stars = [StarDisc { x_px: 60.0, y_px: 200.0, radius_px: 14.0 }, StarDisc { x_px: 200.0, y_px: 90.0, radius_px: 30.0 }];
    let sky_frame =
        SkyFrame { number: 3, lowest_read_dn: 0.0, frame: &frame, stars: &stars, bad: None, exposure_s: Some(2.0), is_compared: false };
    FrameStatistics::of(&sky_frame).and_then(|own| own.mesh).unwrap()
}

/// Deviations of the cells from a shape and the level of all, in standard errors.
fn deviations(mesh: &SkyMesh, shape: Shape) -> Vec<f64> {
    let cells: Vec<&SkyCell> = mesh.cells.iter().flatten().collect();
    let rest = |cell: &SkyCell| cell.level_dn - 0.5 * SKY_E * shape(cell.at);
    let weight: f64 = cells.iter().map(|cell| cell.sigma_dn.powi(-2)).sum();
    let mean = cells.iter().map(|cell| rest(cell) * cell.sigma_dn.powi(-2)).sum::<f64>() / weight;
    cells.iter().map(|cell| (rest(cell) - mean) / cell.sigma_dn).collect()
}

#[test]
fn errors_of_the_levels_are_those_stated() {
    for (name, stars, shape) in [
        ("even", 0, (|_| 0.0) as Shape),
        ("gradient", 0, |at| 0.2 * at[0] - 0.1 * at[1]),
        ("faint stars", 10_000, |_| 0.0),
        ("faint stars on a glow", 10_000, |at| 0.3 * (-((at[0] + 0.78).hypot(at[1] + 0.62)) / 0.4).exp()),
    ] {
        let (mut square, mut count, mut worst) = (0.0, 0, 0.0_f64);
        for seed in 0..20 {
            let mesh = mesh(seed, stars, shape);
            assert_eq!((mesh.frame, mesh.shape), (3, [8, 8]));
            let all = deviations(&mesh, shape);
            square += all.iter().map(|d| d * d).sum::<f64>();
            worst = all.iter().fold(worst, |worst, d| worst.max(d.abs()));
            count += all.len() - 1;
        }
        let scatter = (square / f64::from(u32::try_from(count).unwrap())).sqrt();
        println!("{name}: scatter {scatter:.3}, worst {worst:.1} of {count}");
        assert!((0.8..1.25).contains(&scatter), "{name}: scatter {scatter}");
        assert!(worst < 6.0, "{name}: {worst}");
    }
}

/// A shape that is not there is not found, and one that is there is: the deviations above could not hide it.
#[test]
fn a_wrong_shape_shows_in_the_deviations() {
    let shape: Shape = |at| 0.05 * at[0];
    let own = deviations(&mesh(1, 0, shape), |_| 0.0);
    let scatter = (own.iter().map(|d| d * d).sum::<f64>() / own.len() as f64).sqrt();
    assert!(scatter > 3.0, "{scatter}");
}

/// Cells of two frames of a size are the same, though stars cover blocks of one.
#[test]
fn all_frames_of_a_size_have_the_same_cells() {
    let shape = |covered: usize| {
        let block = |place: [usize; 2]| sky_pixels::Block { place, level_dn: 100.0, slope_dn: [0.0; 2], variance_dn2: 1.0, pixels: 256 };
        let blocks: Vec<sky_pixels::Block> = (covered..256).map(|k| block([k % 16, k / 16])).collect();
        let frame = MeshFrame { number: 0, exposure_s: None, size_px: [256, 256], noise_dn: 1.0 };
        SkyMesh::of(&frame, &blocks, [16, 16]).unwrap().shape
    };
    assert_eq!([0, 1, 36, 100].map(shape), [[8, 8]; 4]);
}

/// Cells lie in one quarter of the frame each, whatever its size, and are no more than agreed.
#[test]
fn no_cell_lies_across_the_middle() {
    for size_px in [[96, 96], [640, 480], [1000, 700], [2048, 128]] {
        let blocks: Vec<sky_pixels::Block> = (0..size_px[1] / 16)
            .flat_map(|row| (0..size_px[0] / 16).map(move |column| [column, row]))
            .map(|place| sky_pixels::Block {
                place,
                level_dn: if 16 * place[1] >= size_px[1] / 2 { 110.0 } else { 100.0 },
                slope_dn: [0.0; 2],
                variance_dn2: 1.0,
                pixels: 256,
            })
            .collect();
        let frame = MeshFrame { number: 0, exposure_s: None, size_px, noise_dn: 1.0 };
        let mesh = SkyMesh::of(&frame, &blocks, [size_px[0] / 16, size_px[1] / 16]).unwrap();
        assert!(mesh.cells.len() <= sky_mesh::MAX_CELLS && mesh.cells.len() >= 4, "{size_px:?}: {:?}", mesh.shape);
        for cell in mesh.cells.iter().flatten() {
            let level_dn = if cell.at[1] > 0.0 { 110.0 } else { 100.0 };
            // The surface through both halves is smooth, and cells have few blocks: what they tell is theirs all the same.
            assert!((cell.level_dn - level_dn).abs() < 1e-6 + 0.5, "{size_px:?} {cell:?}");
        }
    }
}
