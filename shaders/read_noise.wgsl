// Read noise: a normal number. Twin and page: src/effects/detector/read_noise.rs

struct ReadNoiseUniforms {
    sigma_e: f32,
}

fn read_noise(electrons: f32, pixel: Pixel) -> f32 {
    let random = words(pixel.index, READ_NOISE_STAGE, 0u);
    return electrons + effects.read_noise.sigma_e * standard_normal(random.x, random.y);
}
