// Collects the light of the stars whose point spread is a product of two profiles, in two steps and without atomics, so that a run repeats to
// the bit. POINT_SPREAD_quad(star, first, fraction) is the share of a star's light along an axis in four pixels.
//   profiles: for each entry of the tiles' lists, the star's profile along the tile's 16 columns and 16 rows; an invocation is one of the two.
//   collect:  a workgroup is a tile that has entries, an invocation is a square of four times four pixels that goes through its tile's list in
//             catalogue order. GOES_ON: it begins with what the pixels hold; else with nothing.
// Some drivers fetch each invocation's memory one after the other: few large accesses are faster than many small ones.

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

// A part of the tiles that have entries.
struct Part {
    // The first of them.
    first_list: u32,
    // Entries of all tiles.
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
// 8 quads an entry: electrons along the columns, then shares along the rows.
@group(0) @binding(5) var<storage, read_write> profile: array<vec4<f32>>;

@compute @workgroup_size(64)
fn profiles(@builtin(workgroup_id) group: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    let index = (group.y * groups.x + group.x) * 64u + local;
    if (index >= 2u * part.all_entries) {
        return;
    }
    let entry = tile_entries[index / 2u];
    let star = stars[entry.star];
    let along_columns = (index & 1u) == 0u;
    let row_of_tiles = entry.tile / frame.tile_columns;
    let column = i32(16u * (entry.tile - row_of_tiles * frame.tile_columns)) - star.column;
    let row = i32(16u * row_of_tiles + frame.first_row) - star.row;
    let first = select(row, column, along_columns);
    let fraction = select(star.fraction_y, star.fraction_x, along_columns);
    let scale = select(1.0, star.electrons, along_columns);
    for (var quad = 0; quad < 4; quad++) {
        let begin = first + 4 * quad;
        let shares = POINT_SPREAD_quad(star, f32(begin), fraction);
        let reached = abs(vec4<i32>(begin) + vec4<i32>(0, 1, 2, 3)) <= vec4<i32>(star.reach);
        profile[4u * index + u32(quad)] = select(vec4<f32>(0.0), shares * scale, reached);
    }
}

@compute @workgroup_size(4, 4)
fn collect(@builtin(local_invocation_id) at: vec3<u32>, @builtin(workgroup_id) group: vec3<u32>) {
    let list = tile_lists[part.first_list + group.x];
    let x = 16u * list.column + 4u * at.x;
    let y = 16u * list.row + 4u * at.y;
    if (is_outside(x, y)) {
        return;
    }
    var row_0 = vec4<f32>(0.0);
    var row_1 = vec4<f32>(0.0);
    var row_2 = vec4<f32>(0.0);
    var row_3 = vec4<f32>(0.0);
    if (GOES_ON) {
        row_0 = read_quad(x, y);
        row_1 = read_quad(x, y + 1u);
        row_2 = read_quad(x, y + 2u);
        row_3 = read_quad(x, y + 3u);
    }
    var entry = list.first;
    loop {
        let columns = profile[8u * entry + at.x];
        let rows = profile[8u * entry + 4u + at.y];
        row_0 += columns * rows.x;
        row_1 += columns * rows.y;
        row_2 += columns * rows.z;
        row_3 += columns * rows.w;
        entry++;
        // Asked at the end: some drivers run a loop's body once more where it is asked at the beginning.
        if (entry >= list.end) {
            break;
        }
    }
    write_quad(x, y, row_0);
    write_quad(x, y + 1u, row_1);
    write_quad(x, y + 2u, row_2);
    write_quad(x, y + 3u, row_3);
}
