// Gaussian point spread, integrated over the pixel. Twin and page: src/effects/optics/gaussian_psf.rs

const DENSITY_AT_CENTRE = 0.3989423;
const WIDE_BELOW = 0.4;

// The series about the middle of the pixel, for images that are wide against it.
fn gaussian_psf_wide(d: f32, h: f32) -> f32 {
    let z2 = min(d * h * (d * h), 150.0);
    let h2 = h * h;
    let hermite_2 = z2 - 1.0;
    let hermite_4 = (z2 - 6.0) * z2 + 3.0;
    let hermite_6 = ((z2 - 15.0) * z2 + 45.0) * z2 - 15.0;
    let correction = 1.0 + h2 * (hermite_2 * (1.0 / 24.0) + h2 * (hermite_4 * (1.0 / 1920.0) + h2 * hermite_6 * (1.0 / 322560.0)));
    return h * DENSITY_AT_CENTRE * poly_exp(-0.5 * z2) * correction;
}

// Share of the light along one axis in the pixel whose centre lies d px from the star.
fn gaussian_psf(star: Star, d: f32) -> f32 {
    let h = star.inverse_sigma;
    let near = (abs(d) - 0.5) * h;
    let far = (abs(d) + 0.5) * h;
    let tail_near = normal_upper_tail(abs(near));
    let tail_far = normal_upper_tail(far);
    let narrow = select(1.0 - tail_near - tail_far, tail_near - tail_far, near > 0.0);
    return select(narrow, gaussian_psf_wide(d, h), h < WIDE_BELOW);
}

// The same for four pixels, the first of which lies first_px (a whole number) from the star's own: neighbours share an edge.
fn gaussian_psf_quad(star: Star, first_px: f32, fraction_px: f32) -> vec4<f32> {
    let h = star.inverse_sigma;
    let left = ((first_px + vec4<f32>(-0.5, 0.5, 1.5, 2.5)) - fraction_px) * h;
    let last = ((first_px + 3.5) - fraction_px) * h;
    let right = vec4<f32>(left.yzw, last);
    let tails = vec4<f32>(
        normal_upper_tail(abs(left.x)),
        normal_upper_tail(abs(left.y)),
        normal_upper_tail(abs(left.z)),
        normal_upper_tail(abs(left.w)),
    );
    let tails_right = vec4<f32>(tails.yzw, normal_upper_tail(abs(last)));
    let narrow = select(abs(tails - tails_right), 1.0 - tails - tails_right, left * right < vec4<f32>(0.0));
    let d = (first_px + vec4<f32>(0.0, 1.0, 2.0, 3.0)) - fraction_px;
    let wide = vec4<f32>(gaussian_psf_wide(d.x, h), gaussian_psf_wide(d.y, h), gaussian_psf_wide(d.z, h), gaussian_psf_wide(d.w, h));
    return select(narrow, wide, h < WIDE_BELOW);
}
