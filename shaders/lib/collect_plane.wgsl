// Adds the light of stars whose point spread is any function of two offsets, and whose place may change from row to row.
// SHARE is the share of a star's light in the pixel at (dx, dy). A workgroup is a tile that has entries, an invocation is a pixel that goes through its tile's
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

// A part of the tiles that have entries.
struct Part {
    // The first of them.
    first_list: u32,
    all_entries: u32,
    unused: vec2<u32>,
}

@group(0) @binding(1) var<uniform> part: Part;
@group(0) @binding(2) var<storage, read> stars: array<Star>;
// Column and row of a tile, and the entries that it goes through: at least one, the last before `end`.
struct TileList {
    column: u32,
    row: u32,
    first: u32,
    end: u32,
}
@group(0) @binding(3) var<storage, read> tile_lists: array<TileList>;
struct Entry {
    star: u32,
    tile: u32,
}
@group(0) @binding(4) var<storage, read> tile_entries: array<Entry>;
@group(0) @binding(5) var<storage, read> atlas: array<f32>;
@group(0) @binding(6) var<storage, read_write> electrons: array<f32>;

@compute @workgroup_size(16, 16)
fn collect_plane(@builtin(local_invocation_id) inside: vec3<u32>, @builtin(workgroup_id) group: vec3<u32>) {
    let list = tile_lists[part.first_list + group.x];
    let at = vec2<u32>(16u * list.column + inside.x, 16u * list.row + inside.y);
    if (at.x >= frame.width || at.y >= frame.rows) {
        return;
    }
    let index = at.y * frame.width + at.x;
    var sum = electrons[index];
    for (var entry = list.first; entry < list.end; entry++) {
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
