// Response of the pixels. Twin and page: src/effects/detector/prnu.rs

struct PrnuUniforms {
    relative: f32,
}

fn prnu(electrons: f32, pixel: Pixel) -> f32 {
    let random = fixed_words(pixel.index, PRNU_STAGE, 0u);
    return electrons * max(1.0 + effects.prnu.relative * standard_normal(random.x, random.y), 0.0);
}
