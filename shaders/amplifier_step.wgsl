// Gain and offset of the lower half. Twin and page: src/effects/detector/amplifier_step.rs

struct AmplifierStepUniforms {
    gain: f32,
    offset_e: f32,
    first_row_below: u32,
    width: u32,
}

fn amplifier_step(electrons: f32, pixel: Pixel) -> f32 {
    let below = electrons * effects.amplifier_step.gain + effects.amplifier_step.offset_e;
    return select(electrons, below, pixel.y >= effects.amplifier_step.first_row_below);
}
