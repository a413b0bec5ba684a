// Pixels with a defect. Twin and page: src/effects/detector/hot_pixels.rs

struct HotPixelsUniforms {
    hot_below: u32,
    dead_above: u32,
    blinks_below: u32,
    mean_e: f32,
}

fn hot_pixels(electrons: f32, pixel: Pixel) -> f32 {
    let random = fixed_words(pixel.index, HOT_PIXELS_STAGE, 0u);
    let is_off = random.z < effects.hot_pixels.blinks_below && (words(pixel.index, HOT_PIXELS_STAGE, 0u).x & 1u) == 1u;
    let level = -poly_ln(unit_interval(random.y)) * effects.hot_pixels.mean_e;
    let added = select(0.0, level, random.x < effects.hot_pixels.hot_below && !is_off);
    return select(electrons + added, 0.0, random.x > effects.hot_pixels.dead_above);
}
