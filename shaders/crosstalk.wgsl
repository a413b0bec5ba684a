// Copies of bright pixels in the other half. Twin and page: src/effects/detector/crosstalk.rs

struct CrosstalkUniforms {
    relative: f32,
}

fn crosstalk(pixel: Pixel) -> f32 {
    let mirrored = frame.width - 1u - pixel.x;
    let copy = effects.crosstalk.relative * source_at(i32(mirrored), i32(pixel.y));
    return source_at(i32(pixel.x), i32(pixel.y)) + select(copy, 0.0, mirrored == pixel.x);
}
