//! How well anything can be seen in a recording: signal-to-noise ratios of displacements after one attitude for each frame and the
//! camera's x0, y0, f, k1, p1, p2 have taken up what they can (Fisher information of a linear model with the true errors).

use super::kind::Hidden;
use super::world::{GeneratedStarImage, Optics, World};

/// What a displacement of given size leaves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Signal {
    /// Length of what is left, in standard errors.
    pub snr: f64,
    /// rms displacement per star image (2-D) before anything is taken up, px.
    pub raw_rms_px: f64,
    /// Share of the length that is left.
    pub survival: f64,
}

/// The columns that are taken up, orthonormal, for one world.
#[derive(Clone, Debug)]
pub struct Fisher<'w> {
    world: &'w World,
    /// First image of every frame, and the end.
    starts: Vec<usize>,
    /// Three orthonormal columns of each frame, whitened, x and y in turn.
    attitudes: Vec<Vec<Vec<f64>>>,
    /// The camera's, after the attitudes are taken out.
    camera: Vec<Vec<f64>>,
}

fn product(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

fn take_out(from: &mut [f64], unit: &[f64]) {
    let share = product(from, unit);
    for (value, direction) in from.iter_mut().zip(unit) {
        *value -= share * direction;
    }
}

/// Appends what is new in a column, normalised; what is not new (to 1e-9) is left out.
fn extend(basis: &mut Vec<Vec<f64>>, mut column: Vec<f64>) {
    let before = product(&column, &column).sqrt();
    for _ in 0..2 {
        for unit in basis.iter() {
            take_out(&mut column, unit);
        }
    }
    let left = product(&column, &column).sqrt();
    if left > 1e-9 * before && left > 0.0 {
        basis.push(column.into_iter().map(|value| value / left).collect());
    }
}

impl<'w> Fisher<'w> {
    /// For a world.
    #[must_use]
    pub fn new(world: &'w World) -> Self {
        let mut starts = vec![0; world.frames.len() + 1];
        for image in &world.images {
            starts[image.frame + 1] += 1;
        }
        for frame in 0..world.frames.len() {
            starts[frame + 1] += starts[frame];
        }
        let (f, half) = (world.optics.focal_px, world.optics.width_px as f64 / 2.0);
        let places: Vec<_> =
            world.predict(&[]).into_iter().map(|[x, y]| [x - world.optics.centre_px[0], y - world.optics.centre_px[1]]).collect();
        let column = |range: std::ops::Range<usize>, field: &dyn Fn(f64, f64) -> [f64; 2]| -> Vec<f64> {
            range.flat_map(|i| field(places[i][0], places[i][1]).map(|value| value / world.images[i].sigma_px)).collect()
        };
        let turns: [&dyn Fn(f64, f64) -> [f64; 2]; 3] =
            [&|x, y| [x * y / f, f + y * y / f], &|x, y| [f + x * x / f, x * y / f], &|x, y| [y, -x]];
        let attitudes = (0..world.frames.len())
            .map(|frame| {
                let mut basis = Vec::new();
                for turn in turns {
                    extend(&mut basis, column(starts[frame]..starts[frame + 1], turn));
                }
                basis
            })
            .collect();
        let mut fisher = Self { world, starts, attitudes, camera: Vec::new() };
        // The camera's columns at its true distortion: what stands in for a hidden displacement moves the principal point by many pixels, and
        // with decentring that is a change of aspect too.
        let half2 = half * half;
        let changes: [fn(&mut Optics, f64); 6] = [
            |optics, by| optics.centre_px[0] += by,
            |optics, by| optics.centre_px[1] += by,
            |optics, by| optics.focal_px += by,
            |optics, by| optics.k1 += by,
            |optics, by| optics.p1 += by,
            |optics, by| optics.p2 += by,
        ];
        let steps = [0.1, 0.1, 0.1, 0.1 / (half2 * half), 0.1 / half2, 0.1 / half2];
        let mut camera = Vec::new();
        for (change, step) in changes.into_iter().zip(steps) {
            let moved = |by: f64| {
                let mut other = world.clone();
                change(&mut other.optics, by);
                other.predict(&[])
            };
            let (more, less) = (moved(step), moved(-step));
            let of =
                |((a, b), image): ((&[f64; 2], &[f64; 2]), &GeneratedStarImage)| [0, 1].map(|axis| (a[axis] - b[axis]) / image.sigma_px);
            let mut whole: Vec<f64> = more.iter().zip(&less).zip(&world.images).flat_map(of).collect();
            fisher.without_attitudes(&mut whole);
            extend(&mut camera, whole);
        }
        fisher.camera = camera;
        fisher
    }

    fn without_attitudes(&self, column: &mut [f64]) {
        for (frame, basis) in self.attitudes.iter().enumerate() {
            let part = &mut column[2 * self.starts[frame]..2 * self.starts[frame + 1]];
            for unit in basis {
                take_out(part, unit);
            }
        }
    }

    /// What attitudes and camera leave of a whitened column.
    pub fn project(&self, column: &mut [f64]) {
        for _ in 0..2 {
            self.without_attitudes(column);
            for unit in &self.camera {
                take_out(column, unit);
            }
        }
    }

    /// The whitened displacement of all star images, x and y in turn, and its raw rms.
    fn displacement(&self, hidden: &Hidden) -> (Vec<f64>, f64) {
        let (with, without) = (self.world.predict(std::slice::from_ref(hidden)), self.world.predict(&[]));
        let mut square = 0.0;
        let mut column = Vec::with_capacity(2 * with.len());
        for ((a, b), image) in with.iter().zip(&without).zip(&self.world.images) {
            for axis in 0..2 {
                let shift = a[axis] - b[axis];
                square += shift * shift;
                column.push(shift / image.sigma_px);
            }
        }
        (column, (square / with.len().max(1) as f64).sqrt())
    }

    /// What is left of a hidden displacement at its size.
    #[must_use]
    pub fn signal(&self, hidden: &Hidden) -> Signal {
        let (mut column, raw_rms_px) = self.displacement(hidden);
        let whole = product(&column, &column).sqrt();
        self.project(&mut column);
        let snr = product(&column, &column).sqrt();
        Signal { snr, raw_rms_px, survival: if whole > 0.0 { snr / whole } else { 0.0 } }
    }

    /// The part of a displacement that is left, unwhitened in nothing: for angles between displacements.
    #[must_use]
    pub fn left(&self, hidden: &Hidden) -> Vec<f64> {
        let (mut column, _) = self.displacement(hidden);
        self.project(&mut column);
        column
    }

    /// Cosine of the angle between a displacement and the space of others, after projection: 1 if they can stand in for it.
    #[must_use]
    pub fn cosine(&self, of: &[f64], others: &[Hidden]) -> f64 {
        let mut basis = Vec::new();
        for other in others {
            let (mut column, _) = self.displacement(other);
            let whole = product(&column, &column);
            self.project(&mut column);
            // What is taken up itself stands in for nothing.
            if product(&column, &column) > 1e-6 * whole {
                extend(&mut basis, column);
            }
        }
        let share: f64 = basis.iter().map(|unit| product(of, unit).powi(2)).sum();
        (share / product(of, of).max(f64::MIN_POSITIVE)).sqrt()
    }
}
