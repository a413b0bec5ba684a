// The frame as it was, in one buffer; places beyond its edge are those at the edge.
fn source_at(x: i32, y: i32) -> f32 {
    let row = u32(clamp(y, 0, i32(around.height) - 1));
    return source[row * frame.width + u32(clamp(x, 0, i32(frame.width) - 1))];
}
