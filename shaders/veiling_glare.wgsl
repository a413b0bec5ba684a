// An even veil of scattered star light. Twin and page: src/effects/optics/veiling_glare.rs

struct VeilingGlareUniforms {
    kept: f32,
    veil_e_per_px: f32,
}

fn veiling_glare(electrons: f32, pixel: Pixel) -> f32 {
    return electrons * effects.veiling_glare.kept + effects.veiling_glare.veil_e_per_px;
}
