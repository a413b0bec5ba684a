//! Least squares of the edge of a field stop: centre, radius, penumbra, and the levels on both sides.

use nalgebra::{Cholesky, SMatrix, SVector};

use crate::statistics::median_in_place;

/// Numbers of an edge.
const NUMBERS: usize = 7;
/// The centre is the frame's middle within this share of the radius, unless the edge says otherwise.
const OFF_CENTRE: f64 = 0.1;
/// Residuals beyond so many standard deviations count by their size (Huber).
const ROBUST: f64 = 2.5;
/// A narrower penumbra is no wider than a pixel.
const NARROWEST: f64 = 0.7;
const STEPS: usize = 20;

/// An edge of the field.
#[derive(Clone, Copy, Debug)]
pub(super) struct Edge {
    pub(super) centre: [f64; 2],
    pub(super) radius: f64,
    pub(super) width: f64,
    /// Level just inside, its rise per px inwards, and level outside.
    pub(super) inside: f64,
    pub(super) slope: f64,
    pub(super) outside: f64,
}

/// A pixel beside it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Spot {
    pub(super) at: [f64; 2],
    pub(super) value: f64,
}

/// An edge as fitted.
#[derive(Clone, Copy, Debug)]
pub(super) struct EdgeFit {
    pub(super) edge: Edge,
    pub(super) sigma: EdgeSigma,
    /// χ² of a smooth profile less that of the edge.
    pub(super) better: f64,
}

/// Standard errors.
#[derive(Clone, Copy, Debug)]
pub(super) struct EdgeSigma {
    pub(super) radius: f64,
    pub(super) fall: f64,
}

type Normal = SMatrix<f64, NUMBERS, NUMBERS>;
type Numbers = SVector<f64, NUMBERS>;

impl Edge {
    /// How far outside a place lies.
    pub(super) fn away(&self, at: [f64; 2]) -> f64 {
        (at[0] - self.centre[0]).hypot(at[1] - self.centre[1]) - self.radius
    }

    /// The level just inside less that outside.
    pub(super) fn fall(&self) -> f64 {
        self.inside - self.outside
    }

    /// The level at a place, and its derivatives.
    fn level(&self, at: [f64; 2]) -> (f64, Numbers) {
        let away = self.away(at);
        let distance = (away + self.radius).max(1e-9);
        let share = (1.0 + (4.0 * away / self.width).clamp(-60.0, 60.0).exp()).recip();
        let lit = self.inside - self.slope * away - self.outside;
        let steep = -4.0 / self.width * share * (1.0 - share);
        let by_away = lit * steep - self.slope * share;
        let [x, y] = [0, 1].map(|axis| (at[axis] - self.centre[axis]) / distance);
        let by_width = -lit * steep * away / self.width;
        let derivatives = Numbers::from([-x * by_away, -y * by_away, -by_away, by_width, share, -share * away, 1.0 - share]);
        (self.outside + share * lit, derivatives)
    }

    fn moved(&self, step: &Numbers) -> Self {
        Self {
            centre: [self.centre[0] + step[0], self.centre[1] + step[1]],
            radius: self.radius + step[2],
            width: (self.width + step[3]).clamp(NARROWEST.max(0.5 * self.width), (2.0 * self.width).max(NARROWEST)),
            inside: self.inside + step[4],
            slope: self.slope + step[5],
            outside: self.outside + step[6],
        }
    }
}

/// Robust sum of squares of residuals in units of a scale, and the weight of one.
fn loss(rest: f64) -> (f64, f64) {
    let size = rest.abs();
    if size <= ROBUST { (rest * rest, 1.0) } else { (ROBUST * (2.0 * size - ROBUST), ROBUST / size) }
}

impl EdgeFit {
    /// From a start whose levels are not asked for; nothing where the squares do not determine an edge.
    pub(super) fn of(spots: &[Spot], start: Edge) -> Option<Self> {
        if spots.len() < 4 * NUMBERS {
            return None;
        }
        let side = |outside: bool| {
            let mut own: Vec<f64> = spots.iter().filter(|spot| (start.away(spot.at) > 0.0) == outside).map(|spot| spot.value).collect();
            median_in_place(&mut own)
        };
        let mut edge = Edge { inside: side(false)?, outside: side(true)?, slope: 0.0, ..start };
        let middle = start.centre;
        let mut scale = scale(spots, &edge);
        let mut cost = cost(spots, &edge, middle, scale);
        let mut damping = 1e-3;
        for _ in 0..STEPS {
            let (normal, right) = normal(spots, &edge, middle, scale);
            let step = Cholesky::new(damped(&normal, damping))?.solve(&right);
            let next = edge.moved(&step);
            let own = self::cost(spots, &next, middle, scale);
            if own < cost {
                let is_done = cost - own < 1e-6 * cost;
                edge = next;
                damping *= 0.2;
                scale = self::scale(spots, &edge);
                cost = self::cost(spots, &edge, middle, scale);
                if is_done {
                    break;
                }
            } else {
                damping *= 8.0;
            }
        }
        let (normal, _) = normal(spots, &edge, middle, scale);
        let covariance = Cholesky::new(damped(&normal, 1e-12))?.inverse();
        let fall = covariance[(4, 4)] + covariance[(6, 6)] - 2.0 * covariance[(4, 6)];
        let sigma = EdgeSigma { radius: covariance[(2, 2)].sqrt(), fall: fall.max(0.0).sqrt() };
        let own: f64 = spots.iter().map(|spot| loss((spot.value - edge.level(spot.at).0) / scale).0).sum();
        let is_edge = edge.radius > 0.0 && [edge.radius, edge.width, sigma.radius, sigma.fall].iter().all(|value| value.is_finite());
        is_edge.then_some(Self { edge, sigma, better: smooth_cost(spots, &edge, scale)? - own })
    }
}

/// Scatter of the residuals, by their median; never less than what counts in units of noise can have.
fn scale(spots: &[Spot], edge: &Edge) -> f64 {
    let mut rests: Vec<f64> = spots.iter().map(|spot| (spot.value - edge.level(spot.at).0).abs()).collect();
    (1.4826 * median_in_place(&mut rests).unwrap_or(1.0)).max(0.05)
}

fn cost(spots: &[Spot], edge: &Edge, middle: [f64; 2], scale: f64) -> f64 {
    let off = [0, 1].map(|axis| (edge.centre[axis] - middle[axis]) / (OFF_CENTRE * edge.radius));
    let squares: f64 = spots.iter().map(|spot| loss((spot.value - edge.level(spot.at).0) / scale).0).sum();
    squares + off[0] * off[0] + off[1] * off[1]
}

fn normal(spots: &[Spot], edge: &Edge, middle: [f64; 2], scale: f64) -> (Normal, Numbers) {
    let (mut normal, mut right) = (Normal::zeros(), Numbers::zeros());
    for spot in spots {
        let (level, derivatives) = edge.level(spot.at);
        let rest = (spot.value - level) / scale;
        let weight = loss(rest).1;
        let row = derivatives / scale;
        normal += row * row.transpose() * weight;
        right += row * (rest * weight);
    }
    let known = (OFF_CENTRE * edge.radius).powi(-2);
    for axis in 0..2 {
        normal[(axis, axis)] += known;
        right[axis] += known * (middle[axis] - edge.centre[axis]);
    }
    (normal, right)
}

fn damped(normal: &Normal, damping: f64) -> Normal {
    let mut own = *normal;
    for k in 0..NUMBERS {
        own[(k, k)] += damping * normal[(k, k)] + f64::MIN_POSITIVE;
    }
    own
}

/// χ² of a cubic in the distance from the edge's centre, with as robust a loss and the same scale.
fn smooth_cost(spots: &[Spot], edge: &Edge, scale: f64) -> Option<f64> {
    const TURNS: usize = 6;
    let reach = spots.iter().map(|spot| edge.away(spot.at).abs()).fold(1e-9, f64::max);
    let row = |spot: &Spot| {
        let t = edge.away(spot.at) / reach;
        SVector::<f64, 4>::from([1.0, t, t * t, t * t * t])
    };
    let mut value = SVector::<f64, 4>::zeros();
    for turn in 0..TURNS {
        let (mut normal, mut right) = (SMatrix::<f64, 4, 4>::zeros(), SVector::<f64, 4>::zeros());
        for spot in spots {
            let own = row(spot);
            let weight = if turn == 0 { 1.0 } else { loss((spot.value - own.dot(&value)) / scale).1 };
            normal += own * own.transpose() * weight;
            right += own * (spot.value * weight);
        }
        value = Cholesky::new(normal)?.solve(&right);
    }
    Some(spots.iter().map(|spot| loss((spot.value - row(spot).dot(&value)) / scale).0).sum())
}
