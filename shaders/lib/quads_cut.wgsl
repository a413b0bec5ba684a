// The frame's electrons in fours, of which the last in a row may reach beyond the frame.

@group(0) @binding(6) var<storage, read_write> electrons: array<f32>;

fn is_outside(x: u32, y: u32) -> bool {
    return x >= frame.width || y >= frame.rows;
}

fn read_quad(x: u32, y: u32) -> vec4<f32> {
    let row = min(y, frame.rows - 1u) * frame.width;
    let last = frame.width - 1u;
    return vec4<f32>(electrons[row + x], electrons[row + min(x + 1u, last)], electrons[row + min(x + 2u, last)], electrons[row + min(x + 3u, last)]);
}

fn write_quad(x: u32, y: u32, values: vec4<f32>) {
    if (y >= frame.rows) {
        return;
    }
    let first = y * frame.width + x;
    electrons[first] = values.x;
    if (x + 1u < frame.width) {
        electrons[first + 1u] = values.y;
    }
    if (x + 2u < frame.width) {
        electrons[first + 2u] = values.z;
    }
    if (x + 3u < frame.width) {
        electrons[first + 3u] = values.w;
    }
}
