// Sends each pixel through the chain of effects and packs two counts of 16 bits into a word; an invocation is a word.

@group(0) @binding(3) var<storage, read_write> counts: array<u32>;

@compute @workgroup_size(64)
fn finish(@builtin(workgroup_id) group: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    let word = (group.y * groups.x + group.x) * 64u + local;
    let first = 2u * word;
    if (first >= frame.pixels) {
        return;
    }
    let second = min(first + 1u, frame.pixels - 1u);
    counts[word] = u32(chain(electrons[first], pixel_at(first))) | (u32(chain(electrons[second], pixel_at(second))) << 16u);
}
