// A response that bends. Twin and page: src/effects/detector/nonlinearity.rs

struct NonlinearityUniforms {
    relative_at_full: f32,
    per_full_well: f32,
}

fn nonlinearity(electrons: f32, pixel: Pixel) -> f32 {
    let filling = clamp(electrons * effects.nonlinearity.per_full_well, 0.0, 1.0);
    return electrons * (1.0 - effects.nonlinearity.relative_at_full * filling);
}
