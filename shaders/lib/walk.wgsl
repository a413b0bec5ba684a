// A line pass: an invocation is a column or a row of the band and goes along a part of it, pixel by pixel. STEP(electrons, pixel, carry) is
// one step; SWEEP, ALONG_ROWS and BACKWARD are constants.

struct Part {
    // The part of the lines: pixels from first up to first + count - 1.
    first: u32,
    count: u32,
    // 1: the line begins here, 0: it goes on from what an earlier part left.
    begins: u32,
    unused: u32,
}

@group(0) @binding(3) var<storage, read_write> carries: array<vec4<f32>>;
@group(0) @binding(4) var<uniform> part: Part;

@compute @workgroup_size(64)
fn walk(@builtin(workgroup_id) group: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    let line = (group.y * groups.x + group.x) * 64u + local;
    if (line >= select(frame.width, frame.rows, ALONG_ROWS)) {
        return;
    }
    var carry = vec4<f32>();
    if (part.begins == 0u) {
        carry = carries[line];
    }
    for (var turn = 0u; turn < part.count; turn++) {
        let along = part.first + select(turn, part.count - 1u - turn, BACKWARD);
        let x = select(line, along, ALONG_ROWS);
        let y = select(along, line, ALONG_ROWS);
        let index = y * frame.width + x;
        let pixel = Pixel(index + frame.first_row * frame.width, x, y + frame.first_row);
        electrons[index] = STEP(electrons[index], pixel, &carry);
    }
    carries[line] = carry;
}
