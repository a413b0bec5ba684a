//! The slope of a frame's background as a smooth field: what the stamps of all its stars tell together.
//!
//! The slope in one star's stamp holds the light of a neighbour that no catalogue lists, and that neighbour moves the star's measured place in the same
//! direction: taken as it stands it looks like stray light. The light of Moon, Sun, Earth or twilight is smooth over a frame, that of a neighbour is not.

use crate::detect::{Detection, Detections};
use crate::statistics::cholesky::solve;
use crate::statistics::mad_sigma;

/// Polynomials of a place to the second degree.
const TERMS: usize = 6;
/// Stars for each of a polynomial's coefficients; where there are fewer it is of a lower degree.
const STARS_PER_TERM: usize = 4;
/// Steps of the robust fit; each weighs the stars anew.
const STEPS: usize = 12;
/// Tukey's biweight is zero beyond so many standard deviations: 95 % of the efficiency of least squares for normal errors.
const BIWEIGHT_SIGMAS: f64 = 4.685;

/// The slope of one frame's background.
#[derive(Clone, Copy, Debug)]
pub struct BackgroundSlope {
    middle_px: [f64; 2],
    half_px: f64,
    /// Coefficients of both axes, DN per pixel per pixel.
    coefficients_dn: [[f64; TERMS]; 2],
}

impl BackgroundSlope {
    /// Fitted to the slopes that the frame's stars tell; `None` where none tells any (a slope of zero along both axes is one that was not measured).
    #[must_use]
    pub fn of(detections: &Detections) -> Option<Self> {
        let [width_px, height_px] = [detections.width_px, detections.height_px].map(|size| size as f64);
        let mut field = Self {
            middle_px: [(width_px - 1.0) / 2.0, (height_px - 1.0) / 2.0],
            half_px: (width_px.max(height_px) / 2.0).max(1.0),
            coefficients_dn: [[0.0; TERMS]; 2],
        };
        let tells = |star: &&Detection| {
            let slope = star.background_gradient_dn;
            slope != [0.0; 2] && slope.iter().all(|along| along.is_finite()) && !star.flags.edge && !star.flags.saturated
        };
        let stars: Vec<&Detection> = detections.stars.iter().filter(tells).collect();
        let terms = match stars.len() / STARS_PER_TERM {
            0..3 => 1,
            3..TERMS => 3,
            _ => TERMS,
        };
        let rows: Vec<[f64; TERMS]> = stars.iter().map(|star| field.row(star.x_px, star.y_px)).collect();
        for (axis, coefficients) in field.coefficients_dn.iter_mut().enumerate() {
            let slopes: Vec<f64> = stars.iter().map(|star| star.background_gradient_dn[axis]).collect();
            *coefficients = robust_fit(&rows, &slopes, terms)?;
        }
        Some(field)
    }

    fn row(&self, x_px: f64, y_px: f64) -> [f64; TERMS] {
        let [x, y] = [(x_px - self.middle_px[0]) / self.half_px, (y_px - self.middle_px[1]) / self.half_px];
        [1.0, x, y, x * x, x * y, y * y]
    }

    /// The slope at a place along x and y, DN per pixel per pixel.
    #[must_use]
    pub fn at(&self, x_px: f64, y_px: f64) -> [f64; 2] {
        let row = self.row(x_px, y_px);
        self.coefficients_dn.map(|coefficients| row.iter().zip(coefficients).map(|(term, coefficient)| term * coefficient).sum())
    }
}

/// Coefficients by Tukey's biweight, begun at the median; `None` of no stars.
fn robust_fit(rows: &[[f64; TERMS]], values: &[f64], terms: usize) -> Option<[f64; TERMS]> {
    let mut coefficients = [0.0; TERMS];
    coefficients[0] = crate::statistics::median(values)?;
    for _ in 0..STEPS {
        let left = |(row, value): (&[f64; TERMS], &f64)| value - row.iter().zip(&coefficients).map(|(term, c)| term * c).sum::<f64>();
        let residuals: Vec<f64> = rows.iter().zip(values).map(left).collect();
        let reach = BIWEIGHT_SIGMAS * mad_sigma(&residuals)?;
        let (mut matrix, mut vector) = ([[0.0; TERMS]; TERMS], [0.0; TERMS]);
        for ((row, value), residual) in rows.iter().zip(values).zip(&residuals) {
            // Where more than half the stars agree to the last bit there is nothing to weigh.
            let share = if reach > 0.0 { residual / reach } else { 0.0 };
            let weight = if share.abs() < 1.0 { (1.0 - share * share).powi(2) } else { 0.0 };
            for i in 0..terms {
                vector[i] += weight * row[i] * value;
                for j in 0..terms {
                    matrix[i][j] += weight * row[i] * row[j];
                }
            }
        }
        match solve(&matrix, &vector, terms, 0.0) {
            Some(solved) => coefficients[..terms].copy_from_slice(&solved[..terms]),
            None => break, // stars on a line: the last step's stands
        }
    }
    Some(coefficients)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detect::Flags;
    use rand::{RngExt, SeedableRng};

    fn truth(x_px: f64, y_px: f64) -> [f64; 2] {
        [0.1 + 2e-4 * (x_px - 255.5), -0.05 + 2e-7 * (y_px - 255.5).powi(2)]
    }

    /// Stars of a frame whose background's slope is [`truth`]; every fifth has the light of a neighbour in its stamp.
    fn frame(stars: usize, neighbour_dn: f64) -> Detections {
        let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(5);
        let mut star = |number: usize| {
            let [x_px, y_px] = [0; 2].map(|_| rng.random_range(0.0..511.0));
            let neighbour = if number.is_multiple_of(5) { [neighbour_dn, -neighbour_dn] } else { [0.0; 2] };
            let slope = truth(x_px, y_px);
            Detection {
                x_px,
                y_px,
                covariance_px2: [0.01, 0.0, 0.01],
                flux_dn: 1000.0,
                flux_sigma_dn: 10.0,
                background_dn: 100.0,
                background_gradient_dn: [0, 1].map(|axis: usize| slope[axis] + neighbour[axis] + rng.random_range(-0.01..0.01)),
                width_px: 1.0,
                moments: None,
                chi2_per_dof: 1.0,
                peak_dn: 200.0,
                flags: Flags::default(),
            }
        };
        let stars = (0..stars).map(&mut star).collect();
        Detections { width_px: 512, height_px: 512, background_dn: 100.0, noise_dn: 1.0, stars }
    }

    #[test]
    fn the_slope_is_that_of_the_frame_and_not_that_of_neighbours() {
        for neighbour_dn in [0.0, 3.0] {
            let field = BackgroundSlope::of(&frame(80, neighbour_dn)).unwrap();
            for [x_px, y_px] in [[20.0, 30.0], [255.5, 255.5], [480.0, 90.0]] {
                let (found, true_dn) = (field.at(x_px, y_px), truth(x_px, y_px));
                for axis in 0..2 {
                    assert!((found[axis] - true_dn[axis]).abs() < 0.006, "{neighbour_dn}: {found:?} for {true_dn:?}");
                }
            }
        }
    }

    #[test]
    fn few_stars_tell_one_slope_and_none_tells_nothing() {
        let field = BackgroundSlope::of(&frame(7, 0.0)).unwrap();
        assert_eq!(field.at(0.0, 0.0), field.at(500.0, 300.0));
        assert!(BackgroundSlope::of(&frame(0, 0.0)).is_none());
        // A slope of zero is one that was not measured.
        let mut unmeasured = frame(7, 0.0);
        for star in &mut unmeasured.stars {
            star.background_gradient_dn = [0.0; 2];
        }
        assert!(BackgroundSlope::of(&unmeasured).is_none());
    }
}
