// Gains and offsets of the lower and of the right half. Twin and page: src/effects/detector/amplifier_step.rs

struct AmplifierStepUniforms {
    gain: f32,
    offset_e: f32,
    first_row_below: u32,
    gain_right: f32,
    offset_right_e: f32,
    first_column_right: u32,
    width: u32,
}

fn amplifier_step(electrons: f32, pixel: Pixel) -> f32 {
    let below = electrons * effects.amplifier_step.gain + effects.amplifier_step.offset_e;
    let own = select(electrons, below, pixel.y >= effects.amplifier_step.first_row_below);
    let right = own * effects.amplifier_step.gain_right + effects.amplifier_step.offset_right_e;
    return select(own, right, pixel.x >= effects.amplifier_step.first_column_right);
}
