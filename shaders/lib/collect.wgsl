// Collects the light of the stars whose point spread is a product of two profiles, in two steps and without atomics, so that a run repeats to
// the bit. POINT_SPREAD(star, offset) is the share of a star's light along an axis.
//   profiles: for each entry of the tiles' lists, the star's profile along the tile's 16 columns and 16 rows; an invocation is one number.
//   collect:  a workgroup is a tile, an invocation is a pixel that goes through its tile's list in catalogue order.

struct Star {
    column: i32,
    row: i32,
    fraction_x: f32,
    fraction_y: f32,
    electrons: f32,
    inverse_sigma: f32,
    reach: i32,
    unused: u32,
}

// A part of each tile's list: a loop must not run too long, so long lists take several dispatches.
struct Part {
    first_entry: u32,
    entries: u32,
    // 1: go on from what an earlier part left in the buffer, 0: begin with nothing.
    goes_on: u32,
    // Entries of all tiles.
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
// 32 numbers an entry: electrons along the columns, then shares along the rows.
@group(0) @binding(5) var<storage, read_write> profile: array<f32>;
@group(0) @binding(6) var<storage, read_write> electrons: array<f32>;

@compute @workgroup_size(64)
fn profiles(@builtin(workgroup_id) group: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    let index = (group.y * groups.x + group.x) * 64u + local;
    if (index >= 32u * part.all_entries) {
        return;
    }
    let entry = tile_entries[index / 32u];
    let star = stars[entry.star];
    let along_columns = (index & 16u) == 0u;
    let in_tile = i32(index & 15u);
    let row_of_tiles = entry.tile / frame.tile_columns;
    let column = i32(16u * (entry.tile - row_of_tiles * frame.tile_columns)) + in_tile - star.column;
    let row = i32(16u * row_of_tiles + frame.first_row) + in_tile - star.row;
    let pixels = select(row, column, along_columns);
    let fraction = select(star.fraction_y, star.fraction_x, along_columns);
    let share = POINT_SPREAD(star, f32(pixels) - fraction);
    let value = select(share, star.electrons * share, along_columns);
    profile[index] = select(0.0, value, abs(pixels) <= star.reach);
}

@compute @workgroup_size(16, 16)
fn collect(@builtin(global_invocation_id) at: vec3<u32>, @builtin(workgroup_id) tile: vec3<u32>) {
    if (at.x >= frame.width || at.y >= frame.rows) {
        return;
    }
    let index = at.y * frame.width + at.x;
    let list = tile.y * frame.tile_columns + tile.x;
    let first = tile_starts[list] + part.first_entry;
    let end = min(tile_starts[list + 1u], first + part.entries);
    var sum = 0.0;
    if (part.goes_on == 1u) {
        sum = electrons[index];
    }
    let in_column = at.x & 15u;
    let in_row = 16u + (at.y & 15u);
    for (var entry = first; entry < end; entry++) {
        sum += profile[32u * entry + in_column] * profile[32u * entry + in_row];
    }
    electrons[index] = sum;
}
