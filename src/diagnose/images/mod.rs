//! What the images tell beside places: brightness, shape, noise and background, as one linear problem with one list of findings.

mod counted;
mod judge;
mod noise;
mod patterns;
mod report;
mod row_fit;
mod rows;
mod selection;
mod stars;
#[cfg(test)]
mod tests;
mod turns;

pub use noise::DeclaredDetector;
pub use report::ImageMeasurements;
pub(super) use report::add_images;
pub use stars::StarMeasurement;

/// aᵀ·b; the library's own product with a transposed matrix is many times slower.
fn products(a: &nalgebra::DMatrix<f64>, b: &nalgebra::DMatrix<f64>) -> nalgebra::DMatrix<f64> {
    super::linear_system::products(a, b)
}
