//! What the images tell beside places: brightness, shape, noise and background, as one linear problem with one list of findings.

mod background;
mod bouguer_line;
mod channel_reports;
mod channel_states;
mod confirmed;
mod copies;
#[cfg(test)]
mod copies_tests;
mod counted;
mod ends_and_rays;
mod expected_stars;
mod forward_selection;
mod frame_levels;
mod frame_motion;
mod frame_widths;
mod halo;
mod jitter;
mod judge;
mod light_lost;
mod measured_detector;
mod narrowing;
mod noise;
mod noise_kind;
mod noise_transfer;
mod patterns;
mod profiles;
mod proposed;
mod rendered;
mod report;
mod row_fit;
mod row_noise;
mod row_solve;
mod rows;
mod selection;
mod shared_noise;
mod single_frames;
#[cfg(test)]
mod single_frames_tests;
mod sky_columns;
mod sky_light;
mod sky_noise;
mod sky_view;
mod stars;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod transfer_tests;
mod turns;
mod withheld;
mod zero_point_scatter;

pub use expected_stars::StarMeasurement;
pub use measured_detector::detector_numbers;
pub use noise_kind::DeclaredDetector;
pub use rendered::StampCamera;
pub use report::ImageMeasurements;
pub(super) use report::add_images;
pub use sky_view::SkyView;

/// aᵀ·b; the library's own product with a transposed matrix is many times slower.
fn products(a: &nalgebra::DMatrix<f64>, b: &nalgebra::DMatrix<f64>) -> nalgebra::DMatrix<f64> {
    super::linear_system::products(a, b)
}
