// Photon noise: a Poisson number. Twin and page: src/effects/detector/photon_noise.rs

const QUANTILE_FROM_E = 10.0;

fn poisson_quantile(lambda: f32, w: f32) -> f32 {
    let root = sqrt(lambda);
    let w2 = w * w;
    let whole = floor(lambda);
    let order_0 = (lambda - whole) + root * w;
    let order_1 = (2.0 + w2) * (1.0 / 6.0);
    let order_2 = w * (1.0 + 0.5 * w2) / (36.0 * root);
    let order_3 = ((w2 * (1.0 / 270.0) + 7.0 / 810.0) * w2 - 8.0 / 405.0) / lambda;
    return whole + floor(order_0 + (order_1 - order_2 + order_3));
}

fn first_survival(l: f32, zero: f32) -> f32 {
    let series = l * (1.0 - l * 0.5 * (1.0 - l * (1.0 / 3.0) * (1.0 - l * 0.25 * (1.0 - l * 0.2))));
    return select(1.0 - zero, series, l < 0.1);
}

// At most 37 rounds: lambda < 10.
fn poisson_inversion(lambda: f32, u: f32) -> f32 {
    var probability = poly_exp(-lambda);
    var survival = first_survival(lambda, probability);
    let last = 6.0 + lambda + 6.5 * sqrt(lambda);
    var k = 0.0;
    while (u < survival && k < last) {
        k += 1.0;
        probability *= lambda / k;
        survival -= probability;
    }
    return k;
}

fn photon_noise(electrons: f32, pixel: Pixel) -> f32 {
    let lambda = max(electrons, 0.0);
    let random = words(pixel.index, PHOTON_NOISE_STAGE, 0u);
    let is_small = lambda < QUANTILE_FROM_E;
    let large = poisson_quantile(max(lambda, QUANTILE_FROM_E), standard_normal(random.x, random.y));
    let small = poisson_inversion(select(0.0, lambda, is_small), unit_interval(random.z));
    return select(large, small, is_small);
}
