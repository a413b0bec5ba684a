// Sky background. Twin and page: src/effects/sky/background.rs

struct BackgroundUniforms {
    electrons_per_px: f32,
}

fn background(electrons: f32, pixel: Pixel) -> f32 {
    return electrons + effects.background.electrons_per_px;
}
