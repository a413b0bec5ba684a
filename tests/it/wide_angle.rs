//! The whole camera with a wide-angle projection, and with a shutter that rolls while the camera turns: there and back, and derivatives.

use boresight::camera::{Camera, Model};
use boresight::coordinates::{CameraAxes, Direction, PixelPoint};
use boresight::effects::{Context, Observation, Sensor};

/// A projection's id, what it has beyond x0, y0 and f, and the largest angle from the boresight at which it is tried.
const PROJECTIONS: &[(&str, &[f64], f64)] = &[
    ("equidistant", &[], 100.0),
    ("equisolid", &[], 80.0),
    ("stereographic", &[], 80.0),
    ("kannala-brandt", &[-0.02, 0.004, -0.003, 0.001], 80.0),
];

fn wide(id: &str, own: &[f64]) -> Model {
    let camera = Camera { principal_point_px: [1030.0, 1010.0], ..Camera::pinhole(2048, 2048, 560.0) };
    Model::new(camera).with_projection(id, own).unwrap()
}

fn direction(theta_deg: f64, azimuth_deg: f64) -> Direction<CameraAxes> {
    let (sin, cos) = theta_deg.to_radians().sin_cos();
    let azimuth = azimuth_deg.to_radians();
    Direction::along([sin * azimuth.cos(), sin * azimuth.sin(), cos])
}

/// A camera that turns at 1°/s while its shutter rolls.
fn turning(model: &Model) -> Context {
    let sensor = Sensor { width_px: 2048, height_px: 2048, line_time_s: Some(-2e-5), last_row_first: true };
    let rate = [0.5, -0.7, 0.51].map(f64::to_radians);
    let observation = Observation { rate_rad_s: Some(rate), sensor: Some(sensor), ..Observation::default() };
    Context::new(model.reference_context().star, observation)
}

#[test]
fn pixels_come_back() {
    for (id, own, largest_deg) in PROJECTIONS {
        let plain = wide(id, own);
        let mut rolling = plain.clone();
        rolling.set("rolling-shutter", &[20.0]).unwrap();
        let context = turning(&plain);
        let mut moved_px = 0.0_f64;
        for step in 0..=20 {
            let theta_deg = largest_deg * f64::from(step) / 20.0;
            for azimuth_deg in [0.0, 37.0, 143.0, 251.0] {
                let out = direction(theta_deg, azimuth_deg);
                let mut points = Vec::new();
                for model in [&plain, &rolling] {
                    let point = model.pixel(&out, &context).unwrap_or_else(|| panic!("{id} has no image at {theta_deg}°"));
                    let back = model.direction(point, &context).unwrap();
                    let again = model.pixel(&back, &context).unwrap();
                    let error_px = (again.x_px - point.x_px).hypot(again.y_px - point.y_px);
                    assert!(error_px < 1e-8, "{id} at {theta_deg}°: {error_px:e} px");
                    assert!(back.angle_rad(&out) < 1e-12, "{id} at {theta_deg}°: {:e} rad", back.angle_rad(&out));
                    points.push(point);
                }
                moved_px = moved_px.max((points[0].x_px - points[1].x_px).hypot(points[0].y_px - points[1].y_px));
            }
        }
        // 1°/s for a thousand rows of 20 µs is 0.02°, 0.2 px at the centre.
        assert!((0.1..1.0).contains(&moved_px), "{id}: a rolling shutter moves stars by {moved_px} px");
    }
}

/// Beyond the sphere, or where the radius of the image no longer grows, there is nothing to see.
#[test]
fn points_beyond_the_image_have_no_direction() {
    let far = PixelPoint { x_px: 1030.0 + 560.0 * 3.2, y_px: 1010.0 };
    for (id, own, _) in PROJECTIONS {
        let model = wide(id, own);
        let context = model.reference_context();
        assert_eq!(model.direction(far, &context).is_some(), *id == "stereographic" || *id == "kannala-brandt", "{id}");
    }
    let folded = wide("kannala-brandt", &[-0.2, 0.0, 0.0, 0.0]);
    assert!(folded.direction(far, &folded.reference_context()).is_none());
    assert!(folded.pixel(&direction(80.0, 10.0), &folded.reference_context()).is_none(), "beyond the fold at 74°");
    assert!(folded.pixel(&direction(70.0, 10.0), &folded.reference_context()).is_some());
}

#[test]
fn derivatives_of_the_seen_direction_agree_with_central_differences() {
    for (id, own, largest_deg) in PROJECTIONS {
        let mut model = wide(id, own);
        model.set("rolling-shutter", &[20.0]).unwrap();
        model.set("thermal-distortion", &[1e-4]).unwrap();
        let turning = turning(&model);
        let context = Context::new(turning.star, Observation { temperature_offset_k: Some(3.0), ..turning.observation });
        let values = model.values();
        let wanted: Vec<usize> = (0..values.len()).collect();
        let parameters = model.parameters();
        for theta_deg in [0.0, 20.0, *largest_deg] {
            let start = model.pixel(&direction(theta_deg, 31.0), &context).unwrap();
            let pixel = [start.x_px, start.y_px];
            let seen = model.seen(&values, &wanted, pixel, &context).unwrap();
            let at = |values: &[f64], pixel| model.seen(values, &[], pixel, &context).unwrap().direction;
            let agree = |high: [f64; 3], low: [f64; 3], step: f64, column: [f64; 3], what: &str| {
                let size = column.iter().fold(0.0_f64, |most, slope| most.max(slope.abs()));
                assert!(size.is_finite(), "{id} {what} at {theta_deg}°: {column:?}");
                for axis in 0..3 {
                    let difference = (high[axis] - low[axis]) / (2.0 * step);
                    let tolerance = 1e-5 * size + 1e-15 / step;
                    assert!((difference - column[axis]).abs() < tolerance, "{id} {what} at {theta_deg}°: {difference:e} {column:?}");
                }
            };
            for (axis, name) in ["column", "row"].into_iter().enumerate() {
                let moved = |sign: f64| {
                    let mut pixel = pixel;
                    pixel[axis] += sign * 0.01;
                    at(&values, pixel)
                };
                agree(moved(1.0), moved(-1.0), 0.01, seen.by_pixel.map(|row| row[axis]), name);
            }
            for index in 0..values.len() {
                let name = &parameters[index].name;
                let step = match name.as_str() {
                    "x0" | "y0" | "f" => 0.01,
                    "k1" => 1e-13,
                    "p1" | "p2" => 1e-10,
                    _ => 1e-3 * values[index].abs(),
                };
                let moved = |sign: f64| {
                    let mut values = values.clone();
                    values[index] += sign * step;
                    at(&values, pixel)
                };
                agree(moved(1.0), moved(-1.0), step, seen.by_parameter[index], name);
            }
        }
    }
}
