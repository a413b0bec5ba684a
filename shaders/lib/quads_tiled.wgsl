// The frame's electrons in fours, where the width is a whole number of tiles. The buffer holds whole rows of tiles, so nothing lies outside.

@group(0) @binding(6) var<storage, read_write> electrons: array<vec4<f32>>;

fn is_outside(x: u32, y: u32) -> bool {
    return false;
}

fn read_quad(x: u32, y: u32) -> vec4<f32> {
    return electrons[(y * frame.width + x) / 4u];
}

fn write_quad(x: u32, y: u32, values: vec4<f32>) {
    electrons[(y * frame.width + x) / 4u] = values;
}
