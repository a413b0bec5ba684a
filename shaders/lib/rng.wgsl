// Counter-based random numbers: Threefry4x32 with 20 rounds, the same integers as src/rng.rs.

fn rotate_left(x: u32, by: u32) -> u32 {
    return (x << by) | (x >> (32u - by));
}

// Two rounds: words (a, b, c, d).
fn two_rounds(words: vec4<u32>, r0: u32, r1: u32, r2: u32, r3: u32) -> vec4<u32> {
    var a = words.x + words.y;
    var c = words.z + words.w;
    var b = rotate_left(words.y, r0) ^ a;
    var d = rotate_left(words.w, r1) ^ c;
    a += d;
    c += b;
    d = rotate_left(d, r2) ^ a;
    b = rotate_left(b, r3) ^ c;
    return vec4<u32>(a, b, c, d);
}

fn even_rounds(words: vec4<u32>) -> vec4<u32> {
    return two_rounds(two_rounds(words, 10u, 26u, 11u, 21u), 13u, 27u, 23u, 5u);
}

fn odd_rounds(words: vec4<u32>) -> vec4<u32> {
    return two_rounds(two_rounds(words, 6u, 20u, 17u, 11u), 25u, 10u, 18u, 20u);
}

// Written out: a loop would count against the iterations that some drivers allow an invocation.
fn threefry4x32(counter: vec4<u32>, k: vec4<u32>) -> vec4<u32> {
    let k4 = 0x1BD11BDAu ^ k.x ^ k.y ^ k.z ^ k.w;
    var x = even_rounds(counter + k) + vec4<u32>(k.y, k.z, k.w, k4 + 1u);
    x = odd_rounds(x) + vec4<u32>(k.z, k.w, k4, k.x + 2u);
    x = even_rounds(x) + vec4<u32>(k.w, k4, k.x, k.y + 3u);
    x = odd_rounds(x) + vec4<u32>(k4, k.x, k.y, k.z + 4u);
    return even_rounds(x) + vec4<u32>(k.x, k.y, k.z, k.w + 5u);
}

// Four words for a pixel (its index in the frame), a stage and the draw-th call there.
fn words(pixel_index: u32, stage: u32, draw: u32) -> vec4<u32> {
    return threefry4x32(vec4<u32>(pixel_index, draw, 0u, 0u), vec4<u32>(frame.seed_low, frame.seed_high, frame.frame_index, stage));
}

// Standard normal numbers of the pixels 4 quad to 4 quad + 3, from one call of `words`: the pairs of Box and Muller (1958), whose two numbers
// are independent.
fn normals(quad: u32, stage: u32) -> vec4<f32> {
    let four = words(quad, stage, 0u);
    return vec4<f32>(normal_pair(four.x, four.y), normal_pair(four.z, four.w));
}
