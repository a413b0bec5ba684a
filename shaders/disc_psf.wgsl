// A disc or ring of even light. Twin and page: src/effects/optics/disc_psf.rs

const DISC_PAIRS = 8u;

// Length of the pixel at dx that lies within +-half of the middle.
fn within(dx: f32, half: f32) -> f32 {
    return max(min(dx + 0.5, half) - max(dx - 0.5, -half), 0.0);
}

fn disc_line(star: Star, dx: f32, v: f32) -> f32 {
    let outer = sqrt(max(star.shape.x * star.shape.x - v * v, 0.0));
    let inner = sqrt(max(star.shape.y * star.shape.y - v * v, 0.0));
    return within(dx, outer) - within(dx, inner);
}

// Share of the light in the pixel whose centre lies (dx, dy) px from the middle of the disc.
fn disc_psf(star: Star, dx: f32, dy: f32) -> f32 {
    var nodes = array<vec2<f32>, 8>(
        vec2<f32>(0.047506254, 0.094725305),
        vec2<f32>(0.14080178, 0.09130171),
        vec2<f32>(0.22900839, 0.08457826),
        vec2<f32>(0.30893812, 0.07479799),
        vec2<f32>(0.3777022, 0.062314486),
        vec2<f32>(0.4328156, 0.047579255),
        vec2<f32>(0.47228751, 0.031126762),
        vec2<f32>(0.49470047, 0.01357623),
    );
    var sum = 0.0;
    for (var k = 0u; k < DISC_PAIRS; k++) {
        let node = nodes[k].x;
        sum += nodes[k].y * star.shape.z * (disc_line(star, dx, dy - node) + disc_line(star, dx, dy + node));
    }
    return sum;
}
