// Sends each pixel through the chain of effects and packs counts of 16 bits in pairs; an invocation is four pixels. The
// buffers reach to the end of the last workgroup: some drivers pay for a branch around all of it.

@group(0) @binding(3) var<storage, read_write> counts: array<vec2<u32>>;

@compute @workgroup_size(64)
fn finish(@builtin(workgroup_id) group: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    let quad = (group.y * groups.x + group.x) * 64u + local;
    let values = vec4<u32>(chain(electrons[quad], quad));
    counts[quad] = values.xz | (values.yw << vec2<u32>(16u));
}
