// Patterns that stay, and the power function: the same lines as src/effects/pixel/pattern.rs.

// Four words for a pixel and a stage that are the same in every frame.
fn fixed_words(pixel_index: u32, stage: u32, draw: u32) -> vec4<u32> {
    return threefry4x32(vec4<u32>(pixel_index, draw | 0x80000000u, 0u, 0u), vec4<u32>(frame.seed_low, frame.seed_high, 0u, stage));
}

// Exponential of a number, held within [-80, 80].
fn exponential(exponent: f32) -> f32 {
    let x = clamp(exponent, -80.0, 80.0);
    let below = poly_exp(-abs(x));
    return select(below, 1.0 / below, x > 0.0);
}

// A number to a power; 0 for what is not positive.
fn power(x: f32, exponent: f32) -> f32 {
    return select(0.0, exponential(exponent * poly_ln(max(x, 1e-30))), x > 1e-30);
}
