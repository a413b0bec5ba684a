// Gaussian point spread, integrated over the pixel. Twin and page: src/effects/optics/gaussian_psf.rs

const DENSITY_AT_CENTRE = 0.3989423;
const WIDE_BELOW = 0.4;

// Share of the light along one axis in the pixel whose centre lies d px from the star.
fn gaussian_psf(star: Star, d: f32) -> f32 {
    let h = star.inverse_sigma;
    let near = (abs(d) - 0.5) * h;
    let far = (abs(d) + 0.5) * h;
    let tail_near = normal_upper_tail(abs(near));
    let tail_far = normal_upper_tail(far);
    let narrow = select(1.0 - tail_near - tail_far, tail_near - tail_far, near > 0.0);
    let z2 = min(d * h * (d * h), 150.0);
    let h2 = h * h;
    let hermite_2 = z2 - 1.0;
    let hermite_4 = (z2 - 6.0) * z2 + 3.0;
    let hermite_6 = ((z2 - 15.0) * z2 + 45.0) * z2 - 15.0;
    let correction = 1.0 + h2 * (hermite_2 * (1.0 / 24.0) + h2 * (hermite_4 * (1.0 / 1920.0) + h2 * hermite_6 * (1.0 / 322560.0)));
    let wide = h * DENSITY_AT_CENTRE * poly_exp(-0.5 * z2) * correction;
    return select(narrow, wide, h < WIDE_BELOW);
}
