// Read noise: a normal number. Twin and page: src/effects/detector/read_noise.rs

struct ReadNoiseUniforms {
    sigma_e: f32,
}

fn read_noise_quad(electrons: vec4<f32>, quad: u32) -> vec4<f32> {
    return electrons + effects.read_noise.sigma_e * normals(quad, READ_NOISE_STAGE);
}
