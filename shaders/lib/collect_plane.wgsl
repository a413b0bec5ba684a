// Adds the light of stars whose point spread is any function of two offsets, and whose place may change from row to row.
// SHARE is the share of a star's light in the pixel at (dx, dy). A workgroup is a tile, an invocation is a pixel that goes through its tile's
// list in catalogue order, so that a run repeats to the bit.

struct Star {
    column: i32,
    row: i32,
    fraction_x: f32,
    fraction_y: f32,
    electrons: f32,
    inverse_sigma: f32,
    shear_x: f32,
    shear_y: f32,
    shape: vec4<f32>,
    reach: i32,
    nodes: u32,
    unused: vec2<u32>,
    node_low: vec4<u32>,
    node_high: vec4<u32>,
    weight_low: vec4<f32>,
    weight_high: vec4<f32>,
}

// A part of each tile's list: a loop must not run too long, so long lists take several dispatches.
struct Part {
    first_entry: u32,
    entries: u32,
    goes_on: u32,
    all_entries: u32,
}

@group(0) @binding(1) var<uniform> part: Part;
@group(0) @binding(2) var<storage, read> stars: array<Star>;
// The entries of tile t are those from tile_starts[t] up to tile_starts[t + 1] - 1.
@group(0) @binding(3) var<storage, read> tile_starts: array<u32>;
struct Entry {
    star: u32,
    tile: u32,
}
@group(0) @binding(4) var<storage, read> tile_entries: array<Entry>;
@group(0) @binding(5) var<storage, read> atlas: array<f32>;
@group(0) @binding(6) var<storage, read_write> electrons: array<f32>;

@compute @workgroup_size(16, 16)
fn collect_plane(@builtin(global_invocation_id) at: vec3<u32>, @builtin(workgroup_id) tile: vec3<u32>) {
    if (at.x >= frame.width || at.y >= frame.rows) {
        return;
    }
    let index = at.y * frame.width + at.x;
    let list = tile.y * frame.tile_columns + tile.x;
    let first = tile_starts[list] + part.first_entry;
    let end = min(tile_starts[list + 1u], first + part.entries);
    var sum = electrons[index];
    for (var entry = first; entry < end; entry++) {
        let star = stars[tile_entries[entry].star];
        let columns = i32(at.x) - star.column;
        let rows = i32(at.y + frame.first_row) - star.row;
        if (abs(columns) <= star.reach && abs(rows) <= star.reach) {
            let along = f32(rows) - star.fraction_y;
            let dx = f32(columns) - (star.fraction_x + star.shear_x * along);
            let dy = along - star.shear_y * along;
            sum += star.electrons * (SHARE);
        }
    }
    electrons[index] = sum;
}
