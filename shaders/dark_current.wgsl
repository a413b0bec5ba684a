// Dark current. Twin and page: src/effects/detector/dark_current.rs

struct DarkCurrentUniforms {
    mean_e: f32,
    log_sigma: f32,
    log_mean: f32,
}

fn dark_current(electrons: f32, pixel: Pixel) -> f32 {
    let random = fixed_words(pixel.index, DARK_CURRENT_STAGE, 0u);
    let logarithm = effects.dark_current.log_mean + effects.dark_current.log_sigma * standard_normal(random.x, random.y);
    return electrons + effects.dark_current.mean_e * exponential(logarithm);
}
