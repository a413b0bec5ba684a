// Sends each pixel through the chain of effects and leaves the electrons where they were; an invocation is four pixels. The
// buffers reach to the end of the last workgroup: some drivers pay for a branch around all of it.

@compute @workgroup_size(64)
fn finish(@builtin(workgroup_id) group: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    let quad = (group.y * groups.x + group.x) * 64u + local;
    electrons[quad] = chain(electrons[quad], quad);
}
