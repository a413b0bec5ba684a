// The frame as it was, in a buffer for each band: that of this band and those before and after it. Places beyond the frame's edge are those at
// the edge.
@group(0) @binding(5) var<storage, read> source_before: array<f32>;
@group(0) @binding(6) var<storage, read> source_after: array<f32>;

fn source_at(x: i32, y: i32) -> f32 {
    let row = clamp(y, 0, i32(around.height) - 1) - i32(frame.first_row);
    let column = u32(clamp(x, 0, i32(frame.width) - 1));
    if (row < 0) {
        return source_before[u32(row + i32(around.rows_before)) * frame.width + column];
    }
    if (row >= i32(frame.rows)) {
        return source_after[(u32(row) - frame.rows) * frame.width + column];
    }
    return source[u32(row) * frame.width + column];
}
