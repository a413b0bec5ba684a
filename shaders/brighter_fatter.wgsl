// Boundaries of pixels that follow the charge. Twin and page: src/effects/detector/brighter_fatter.rs

struct BrighterFatterUniforms {
    half_shift_per_e: f32,
    w_00: f32,
    w_01: f32,
    w_02: f32,
    w_10: f32,
    w_11: f32,
    w_12: f32,
    w_20: f32,
    w_21: f32,
    w_22: f32,
}

// Difference of the charges i pixels behind a boundary on both sides, j beside; the boundary follows pixel (x, y), to the right where `along` is
// (1, 0) and below it where it is (0, 1).
fn difference(x: i32, y: i32, along: vec2<i32>, i: i32, j: i32) -> f32 {
    let near = vec2<i32>(x, y) - i * along + j * along.yx;
    let far = vec2<i32>(x, y) + (i + 1) * along + j * along.yx;
    return source_at(near.x, near.y) - source_at(far.x, far.y);
}

fn beside(x: i32, y: i32, along: vec2<i32>, i: i32, j: i32) -> f32 {
    return difference(x, y, along, i, -j) + difference(x, y, along, i, j);
}

// What flows over the boundary after pixel (x, y).
fn flow(x: i32, y: i32, along: vec2<i32>) -> f32 {
    let on_axis = effects.brighter_fatter.w_00 * difference(x, y, along, 0, 0) + effects.brighter_fatter.w_10 * difference(x, y, along, 1, 0)
        + effects.brighter_fatter.w_20 * difference(x, y, along, 2, 0);
    let one_off = effects.brighter_fatter.w_01 * beside(x, y, along, 0, 1) + effects.brighter_fatter.w_11 * beside(x, y, along, 1, 1)
        + effects.brighter_fatter.w_21 * beside(x, y, along, 2, 1);
    let two_off = effects.brighter_fatter.w_02 * beside(x, y, along, 0, 2) + effects.brighter_fatter.w_12 * beside(x, y, along, 1, 2)
        + effects.brighter_fatter.w_22 * beside(x, y, along, 2, 2);
    let shift = clamp(effects.brighter_fatter.half_shift_per_e * (on_axis + one_off + two_off), -0.25, 0.25);
    let sum = source_at(x, y) + source_at(x + along.x, y + along.y);
    let is_inside = x >= 0 && y >= 0 && x + along.x < i32(frame.width) && y + along.y < i32(around.height);
    return select(0.0, 0.5 * sum * shift, is_inside);
}

fn brighter_fatter(pixel: Pixel) -> f32 {
    let x = i32(pixel.x);
    let y = i32(pixel.y);
    let right = vec2<i32>(1, 0);
    let down = vec2<i32>(0, 1);
    return source_at(x, y) + (flow(x - 1, y, right) - flow(x, y, right)) + (flow(x, y - 1, down) - flow(x, y, down));
}
