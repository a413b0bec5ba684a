// The filters' transmission for all light alike. Twin and page: src/effects/detector/bayer.rs

struct BayerUniforms {
    red: f32,
    blue: f32,
    width: u32,
}

fn bayer(electrons: f32, pixel: Pixel) -> f32 {
    let filtered = electrons * select(effects.bayer.red, effects.bayer.blue, (pixel.y & 1u) == 1u);
    return select(electrons, filtered, (pixel.x & 1u) == (pixel.y & 1u));
}
