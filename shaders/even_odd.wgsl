// Gain of even and odd columns. Twin and page: src/effects/detector/even_odd.rs

struct EvenOddUniforms {
    even: f32,
    odd: f32,
    width: u32,
}

fn even_odd(electrons: f32, pixel: Pixel) -> f32 {
    return electrons * select(effects.even_odd.even, effects.even_odd.odd, (pixel.x & 1u) == 1u);
}
