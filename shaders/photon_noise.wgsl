// Photon noise: a Poisson number. Twin and page: src/effects/detector/photon_noise.rs

const EXPANSION_FROM_E = 12.0;
const ROUGH_INVERSE_ROOT = 0x5f3759dfu;

fn poisson_quantile(lambda: vec4<f32>, w: vec4<f32>) -> vec4<f32> {
    let whole = floor(lambda);
    let part = lambda - whole;
    let root = sqrt(lambda);
    let w2 = w * w + 2.0;
    let inverse_root = bitcast<vec4<f32>>(vec4<u32>(ROUGH_INVERSE_ROOT) - (bitcast<vec4<u32>>(lambda) >> vec4<u32>(1u)));
    let near = whole + floor(part + root * w + w2 * (1.0 / 6.0 - (1.0 / 72.0) * w * inverse_root) + 0.5);
    let m = max(near, vec4<f32>(1.0));
    let difference = (whole - m) + part;
    let scale = 1.0 / sqrt(lambda + m);
    let inverse = scale * scale;
    let t = difference * inverse;
    let a = (((((((0.0872841137 * t - 0.108672987) * t + 0.0817357317) * t - 0.0598661338) * t + 0.105470141) * t - 0.105653824) * t + 0.216110651) * t - 0.235699955) * t + 1.41421356;
    let c1 = (((((((0.920841109 * t - 0.838543406) * t + 0.174959931) * t + 0.145396395) * t + 0.0436860547) * t + 0.0755815762) * t + 0.108217197) * t + 0.15714833) * t + 0.471404521;
    let c2 = (((0.207448841 * t + 0.0480907339) * t + 0.0556984971) * t + 0.0517626576) * t + 0.0227193453;
    let c3 = (-0.154754407 * t - 0.0350709349) * t - 0.0217364629;
    let z = scale * (difference * a + (c1 + inverse * (c2 + inverse * c3)));
    return select(m - 1.0, m, w + z >= vec4<f32>(0.0));
}

fn first_survival(l: vec4<f32>, zero: vec4<f32>) -> vec4<f32> {
    let series = l * (1.0 - l * 0.5 * (1.0 - l * (1.0 / 3.0) * (1.0 - l * 0.25 * (1.0 - l * 0.2))));
    return select(1.0 - zero, series, l < vec4<f32>(0.1));
}

// At most 41 rounds: lambda < 12. One loop for four pixels, since some drivers pay for a loop even if it ends at once.
fn poisson_inversion(lambda: vec4<f32>, u: vec4<f32>) -> vec4<f32> {
    var probability = vec4<f32>(poly_exp(-lambda.x), poly_exp(-lambda.y), poly_exp(-lambda.z), poly_exp(-lambda.w));
    var survival = first_survival(lambda, probability);
    let last = 6.0 + lambda + 6.5 * sqrt(lambda);
    var count = vec4<f32>(0.0);
    var k = 0.0;
    var more = u < survival;
    while (any(more)) {
        k += 1.0;
        count = select(count, vec4<f32>(k), more);
        probability *= lambda * (1.0 / k);
        survival -= probability;
        more = more & (u < survival) & (vec4<f32>(k) < last);
    }
    return count;
}

fn upper_tail(w: vec4<f32>) -> vec4<f32> {
    let x = abs(w);
    let tail = vec4<f32>(normal_upper_tail(x.x), normal_upper_tail(x.y), normal_upper_tail(x.z), normal_upper_tail(x.w));
    return select(tail, 1.0 - tail, w < vec4<f32>(0.0));
}

fn photon_noise_quad(electrons: vec4<f32>, quad: u32) -> vec4<f32> {
    let lambda = max(electrons, vec4<f32>(0.0));
    let w = normals(quad, PHOTON_NOISE_STAGE);
    let large = poisson_quantile(max(lambda, vec4<f32>(EXPANSION_FROM_E)), w);
    if (!PHOTON_NOISE_MAY_BE_FAINT) {
        return large;
    }
    let is_small = lambda < vec4<f32>(EXPANSION_FROM_E);
    let small = poisson_inversion(select(vec4<f32>(0.0), lambda, is_small), upper_tail(w));
    return select(large, small, is_small);
}
