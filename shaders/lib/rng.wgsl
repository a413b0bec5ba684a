// Counter-based random numbers: Philox4x32 with 10 rounds, the same integers as src/rng.rs.

fn multiply_high(a: u32, b: u32) -> u32 {
    let a_low = a & 0xffffu;
    let a_high = a >> 16u;
    let b_low = b & 0xffffu;
    let b_high = b >> 16u;
    let low = a_low * b_low;
    let middle = a_high * b_low + (low >> 16u);
    let other = a_low * b_high + (middle & 0xffffu);
    return a_high * b_high + (middle >> 16u) + (other >> 16u);
}

fn philox_round(c: vec4<u32>, k: vec2<u32>) -> vec4<u32> {
    let high_0 = multiply_high(c.x, 0xD2511F53u);
    let high_1 = multiply_high(c.z, 0xCD9E8D57u);
    return vec4<u32>(high_1 ^ c.y ^ k.x, c.z * 0xCD9E8D57u, high_0 ^ c.w ^ k.y, c.x * 0xD2511F53u);
}

// Written out: a loop would count against the iterations that some drivers allow an invocation.
fn philox4x32(counter: vec4<u32>, key: vec2<u32>) -> vec4<u32> {
    let weyl = vec2<u32>(0x9E3779B9u, 0xBB67AE85u);
    var c = philox_round(counter, key);
    c = philox_round(c, key + weyl);
    c = philox_round(c, key + 2u * weyl);
    c = philox_round(c, key + 3u * weyl);
    c = philox_round(c, key + 4u * weyl);
    c = philox_round(c, key + 5u * weyl);
    c = philox_round(c, key + 6u * weyl);
    c = philox_round(c, key + 7u * weyl);
    c = philox_round(c, key + 8u * weyl);
    return philox_round(c, key + 9u * weyl);
}

// Four words for a pixel (its index in the frame), a stage and the draw-th call there.
fn words(pixel_index: u32, stage: u32, draw: u32) -> vec4<u32> {
    return philox4x32(vec4<u32>(pixel_index, frame.frame_index, stage, draw), vec2<u32>(frame.seed_low, frame.seed_high));
}
