//! Field stops of known radius, and skies that have none.

use super::*;
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, Normal, Poisson};
use rand_pcg::Pcg64Mcg;

const SIDE: usize = 320;
const BIAS_DN: f64 = 100.0;

/// Frames of a sky whose light is a function of place, with photon noise, stars that move, and stars that do not.
fn frames(seed: u64, size: [usize; 2], staying: usize, light_e: impl Fn(f64, f64) -> f64) -> Vec<Frame> {
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    let spot = |rng: &mut Pcg64Mcg| {
        [rng.random_range(0.0..size[0] as f64), rng.random_range(0.0..size[1] as f64), rng.random_range(300.0..9000.0)]
    };
    let fixed: Vec<[f64; 3]> = (0..staying).map(|_| spot(&mut rng)).collect();
    let of_frame = |_| {
        let sky: f64 = 0.6 + 0.8 * rng.random::<f64>();
        let mut stars: Vec<[f64; 3]> = (0..40).map(|_| spot(&mut rng)).collect();
        stars.extend(&fixed);
        let mut light = vec![0.0; size[0] * size[1]];
        for [x, y, electrons] in stars {
            for row in crate::pixel_statistics::sky_frame::covered(y, 6.0, size[1]) {
                for column in crate::pixel_statistics::sky_frame::covered(x, 6.0, size[0]) {
                    let away2 = (column as f64 - x).powi(2) + (row as f64 - y).powi(2);
                    light[row * size[0] + column] += 0.1 * electrons * (-0.35 * away2).exp();
                }
            }
        }
        let middle_e = light_e(0.5 * size[0] as f64, 0.5 * size[1] as f64);
        let read = Normal::new(0.0, 5.0).unwrap();
        let pixel = |(index, star): (usize, &f64)| {
            let shade_e = light_e((index % size[0]) as f64, (index / size[0]) as f64);
            let mean = sky * shade_e + star * (shade_e / middle_e).min(1.0);
            let electrons = if mean > 0.0 { Poisson::new(mean).unwrap().sample(&mut rng) } else { 0.0 };
            (BIAS_DN + 0.8 * (electrons + read.sample(&mut rng))).round().max(0.0) as f32
        };
        let pixels_dn = light.iter().enumerate().map(pixel).collect();
        Frame { width_px: size[0], height_px: size[1], pixels_dn, saturation_dn: 65_535.0 }
    };
    (0..5).map(of_frame).collect()
}

fn found(frames: &[Frame], bias_dn: Option<f64>) -> Option<StopCircle> {
    StopCircle::of(&frames.iter().map(StopFrame::new).collect::<Vec<_>>(), bias_dn)
}

fn stop(centre: [f64; 2], radius: f64, penumbra: f64) -> impl Fn(f64, f64) -> f64 {
    move |x, y| 80.0 * ((radius - (x - centre[0]).hypot(y - centre[1])) / penumbra + 0.5).clamp(0.0, 1.0)
}

#[test]
fn stops_are_found_with_their_radius() {
    let middle = [0.5 * (SIDE as f64 - 1.0); 2];
    let cases = [
        (middle, 120.0, 4.0, SIDE, 0),
        (middle, 160.0, 4.0, SIDE, 30),
        // The corners alone.
        (middle, 205.0, 4.0, SIDE, 0),
        // Hardly anything of them.
        (middle, 220.0, 4.0, SIDE, 0),
        (middle, 150.0, 1.0, SIDE, 0),
        // Off the middle, in both axes.
        ([middle[0] + 25.0, middle[1] - 14.0], 110.0, 6.0, SIDE, 20),
        // Summed in squares.
        ([400.0 - 3.0, 400.0 + 2.0], 350.0, 6.0, 800, 0),
    ];
    for (number, (centre, radius, penumbra, side, staying)) in (0..).zip(cases) {
        let frames = frames(number, [side; 2], staying, stop(centre, radius, penumbra));
        for bias_dn in [None, Some(BIAS_DN)] {
            let own = found(&frames, bias_dn).unwrap_or_else(|| panic!("case {number} is not found"));
            println!("case {number}: {own:?}");
            assert!((own.radius_px - radius).abs() < 1.0, "case {number}: {own:?}");
            assert!((own.radius_px - radius).abs() < 4.0 * own.radius_sigma_px && own.radius_sigma_px < 0.3, "case {number}: {own:?}");
            let off = (own.centre_px[0] - centre[0]).hypot(own.centre_px[1] - centre[1]);
            assert!(off < 1.0, "case {number}: {own:?}");
            // Nothing of the penumbra is kept, and hardly any of the sky is lost.
            let unlit = own.unlit();
            let kept = unlit.iter().filter(|unlit| !**unlit).count() as f64;
            let at = |index: usize| ((index % side) as f64 - centre[0]).hypot((index / side) as f64 - centre[1]);
            assert!((0..side * side).all(|index| unlit[index] || at(index) < radius - 0.5 * penumbra), "case {number}");
            let whole = (0..side * side).filter(|index| at(*index) < radius - 0.5 * penumbra).count() as f64;
            assert!(kept > 0.85 * whole, "case {number}: {kept} of {whole}");
        }
    }
}

type Light = Box<dyn Fn(f64, f64) -> f64>;

#[test]
fn what_falls_slowly_or_on_one_side_is_no_stop() {
    let middle = 0.5 * (SIDE as f64 - 1.0);
    let corner = middle.hypot(middle);
    let radius = move |x: f64, y: f64| (x - middle).hypot(y - middle);
    let skies: Vec<(&str, Light)> = vec![
        ("even", Box::new(|_, _| 80.0)),
        ("bright and even", Box::new(|_, _| 5000.0)),
        ("slope", Box::new(|x, y| 40.0 + 0.2 * x + 0.1 * y)),
        // Four fifths of the light lost in the corner: 1/(1 + t²)².
        ("cosine law", Box::new(move |x, y| 400.0 / (1.0 + 1.236 * (radius(x, y) / corner).powi(2)).powi(2))),
        ("steep vignette", Box::new(move |x, y| 800.0 * (1.0 - 0.95 * (radius(x, y) / corner).powi(4)))),
        ("clipped pupil", Box::new(move |x, y| 800.0 * (1.0 - 1.3 * (radius(x, y) / corner - 0.4).max(0.0)))),
        ("blurred stop", Box::new(move |x, y| 300.0 / (1.0 + ((radius(x, y) - 120.0) / 15.0).exp()))),
        ("horizon", Box::new(|_, y| if y > 230.0 { 5.0 } else { 80.0 })),
        ("halves", Box::new(|_, y| if y > 160.0 { 70.0 } else { 80.0 })),
        ("bars", Box::new(|x, _| if (40.0..280.0).contains(&x) { 80.0 } else { 2.0 })),
        ("roof", Box::new(|x, y| if y > 200.0 + 0.4 * (x - 160.0).abs() { 3.0 } else { 80.0 })),
        ("glow in a corner", Box::new(|x, y| 60.0 + 300.0 * (-x.hypot(y) / 40.0).exp())),
        ("moonlit cloud", Box::new(move |x, y| 60.0 + 90.0 * (-(radius(x, y) / 60.0).powi(2)).exp())),
        ("faint ring", Box::new(move |x, y| if radius(x, y) < 120.0 { 80.0 } else { 70.0 })),
    ];
    for (number, (name, light)) in (100..).zip(&skies) {
        for staying in [0, 60] {
            let frames = frames(number, [SIDE; 2], staying, light);
            let own = found(&frames, Some(BIAS_DN));
            assert!(own.is_none(), "{name}: {own:?}");
        }
    }
}
