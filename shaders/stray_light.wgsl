// A background that rises evenly. Twin and page: src/effects/detector/stray_light.rs

struct StrayLightUniforms {
    slope_x_e: f32,
    slope_y_e: f32,
    middle_x_px: f32,
    middle_y_px: f32,
    width: u32,
}

fn stray_light(electrons: f32, pixel: Pixel) -> f32 {
    let of_row = effects.stray_light.slope_y_e * (f32(pixel.y) - effects.stray_light.middle_y_px);
    return max(electrons + (effects.stray_light.slope_x_e * (f32(pixel.x) - effects.stray_light.middle_x_px) + of_row), 0.0);
}
