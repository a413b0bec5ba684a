// Collects the light of the stars: a workgroup is a tile, an invocation is a pixel that goes through the list of its tile's stars in
// catalogue order. No atomics, so a run repeats to the bit. POINT_SPREAD(star, x, y) is the share of a star's light in a pixel.

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
    unused: u32,
}

@group(0) @binding(1) var<uniform> part: Part;
@group(0) @binding(2) var<storage, read> stars: array<Star>;
// The entries of tile t are tile_entries[tile_starts[t]] up to tile_entries[tile_starts[t + 1] - 1]: numbers of stars.
@group(0) @binding(3) var<storage, read> tile_starts: array<u32>;
@group(0) @binding(4) var<storage, read> tile_entries: array<u32>;
@group(0) @binding(5) var<storage, read_write> electrons: array<f32>;

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
    for (var entry = first; entry < end; entry++) {
        let star = stars[tile_entries[entry]];
        let x = i32(at.x) - star.column;
        let y = i32(at.y + frame.first_row) - star.row;
        let share = POINT_SPREAD(star, x, y);
        sum += select(0.0, star.electrons * share, abs(x) <= star.reach && abs(y) <= star.reach);
    }
    electrons[index] = sum;
}
