// Full well and analogue-to-digital converter. Twin and page: src/effects/detector/adc.rs

struct AdcUniforms {
    dn_per_e: f32,
    bias_and_half_dn: f32,
    full_well_e: f32,
    top_dn: f32,
}

fn adc(electrons: f32, pixel: Pixel) -> f32 {
    let held = min(electrons, effects.adc.full_well_e);
    let exact = held * effects.adc.dn_per_e + effects.adc.bias_and_half_dn;
    return floor(clamp(exact, 0.0, effects.adc.top_dn));
}
