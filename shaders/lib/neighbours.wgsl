// A neighbour pass: every pixel of the band is made anew from the frame as it was; an invocation is a pixel. STEP(pixel) makes it.

struct Around {
    // Rows of the whole frame, and of the band before this one.
    height: u32,
    rows_before: u32,
    unused_0: u32,
    unused_1: u32,
}

@group(0) @binding(2) var<storage, read> source: array<f32>;
@group(0) @binding(3) var<storage, read_write> made: array<f32>;
@group(0) @binding(4) var<uniform> around: Around;

@compute @workgroup_size(64)
fn make_anew(@builtin(workgroup_id) group: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    let index = (group.y * groups.x + group.x) * 64u + local;
    if (index >= frame.pixels) {
        return;
    }
    made[index] = STEP(pixel_at(index));
}
