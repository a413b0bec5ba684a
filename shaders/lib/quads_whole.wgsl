// The frame's electrons in fours, where the width is a multiple of four.

@group(0) @binding(6) var<storage, read_write> electrons: array<vec4<f32>>;

fn is_outside(x: u32, y: u32) -> bool {
    return x >= frame.width || y >= frame.rows;
}

fn read_quad(x: u32, y: u32) -> vec4<f32> {
    return electrons[(min(y, frame.rows - 1u) * frame.width + x) / 4u];
}

fn write_quad(x: u32, y: u32, values: vec4<f32>) {
    if (y < frame.rows) {
        electrons[(y * frame.width + x) / 4u] = values;
    }
}
