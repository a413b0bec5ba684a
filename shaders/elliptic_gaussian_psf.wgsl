// Elliptic Gaussian point spread, integrated over the pixel. Twin and page: src/effects/optics/elliptic_gaussian_psf.rs

const ELLIPTIC_NODES = 8u;

// Share of the light in the pixel whose centre lies (dx, dy) px from the star.
fn elliptic_gaussian_psf(star: Star, dx: f32, dy: f32) -> f32 {
    var nodes = array<vec2<f32>, 8>(
        vec2<f32>(-0.48014493, 0.050614268),
        vec2<f32>(-0.39833324, 0.11119052),
        vec2<f32>(-0.2627662, 0.15685332),
        vec2<f32>(-0.09171732, 0.18134189),
        vec2<f32>(0.09171732, 0.18134189),
        vec2<f32>(0.2627662, 0.15685332),
        vec2<f32>(0.39833324, 0.11119052),
        vec2<f32>(0.48014493, 0.050614268),
    );
    let inverse_sigma_y = star.shape.x;
    var sum = 0.0;
    for (var k = 0u; k < ELLIPTIC_NODES; k++) {
        let v = dy + nodes[k].x;
        let z2 = min(v * inverse_sigma_y * (v * inverse_sigma_y), 150.0);
        let density = inverse_sigma_y * DENSITY_AT_CENTRE * poly_exp(-0.5 * z2);
        sum += nodes[k].y * density * gaussian_psf(star, dx - star.shape.y * v);
    }
    return sum;
}
