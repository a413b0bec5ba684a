// Joins pixels, FACTOR × FACTOR into one, electrons or counts. Twins: `join` and `join_counts` of src/imaging/binning.rs

struct Joining {
    // Joined pixels of a row, and of the band, which begins and ends with whole ones.
    width: u32,
    pixels: u32,
    // What a sum of counts is divided by.
    divisor: u32,
    // The most electrons of a pixel that are joined, and what becomes of their sum.
    full_well_e: f32,
    share: f32,
    unused_0: u32,
    unused_1: u32,
    unused_2: u32,
}

@group(0) @binding(0) var<uniform> joining: Joining;
@group(0) @binding(1) var<storage, read> electrons: array<f32>;
@group(0) @binding(2) var<storage, read_write> joined_e: array<f32>;
// Two counts in a word.
@group(0) @binding(1) var<storage, read> counts: array<u32>;
@group(0) @binding(2) var<storage, read_write> joined_dn: array<u32>;

// The first pixel of a joined one. Those beside it follow; those below it follow after joining.width * FACTOR.
fn first_of(joined: u32) -> u32 {
    let row = joined / joining.width;
    return FACTOR * (joined + row * (FACTOR - 1u) * joining.width);
}

@compute @workgroup_size(64)
fn join(@builtin(workgroup_id) group: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    let joined = (group.y * groups.x + group.x) * 64u + local;
    if (joined >= joining.pixels) {
        return;
    }
    let first = first_of(joined);
    var sum = 0.0;
    for (var line = 0u; line < FACTOR; line += 1u) {
        let start = first + line * joining.width * FACTOR;
        for (var column = 0u; column < FACTOR; column += 1u) {
            sum += min(electrons[start + column], joining.full_well_e);
        }
    }
    joined_e[joined] = sum * joining.share;
}

fn joined_count(joined: u32) -> u32 {
    let first = first_of(joined);
    var sum = 0u;
    for (var line = 0u; line < FACTOR; line += 1u) {
        let start = first + line * joining.width * FACTOR;
        for (var column = 0u; column < FACTOR; column += 1u) {
            let place = start + column;
            sum += (counts[place >> 1u] >> (16u * (place & 1u))) & 0xffffu;
        }
    }
    return min((sum + joining.divisor / 2u) / joining.divisor, 0xffffu);
}

// An invocation is two joined pixels.
@compute @workgroup_size(64)
fn join_counts(@builtin(workgroup_id) group: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    let pair = (group.y * groups.x + group.x) * 64u + local;
    if (2u * pair >= joining.pixels) {
        return;
    }
    var word = joined_count(2u * pair);
    if (2u * pair + 1u < joining.pixels) {
        word |= joined_count(2u * pair + 1u) << 16u;
    }
    joined_dn[pair] = word;
}
