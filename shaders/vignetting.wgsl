// Loss of light towards the corners. Twin and page: src/effects/optics/vignetting.rs

struct VignettingUniforms {
    middle_x_px: f32,
    middle_y_px: f32,
    inverse_radius2: f32,
    tan2_corner: f32,
    loss_second: f32,
    loss_fourth: f32,
    loss_sixth: f32,
    width: u32,
}

fn vignetting(electrons: f32, pixel: Pixel) -> f32 {
    let radius2 = radius2_px(pixel, effects.vignetting.middle_x_px, effects.vignetting.middle_y_px);
    let r2 = radius2 * effects.vignetting.inverse_radius2;
    let left = max(1.0 - r2 * (effects.vignetting.loss_second + r2 * (effects.vignetting.loss_fourth + r2 * effects.vignetting.loss_sixth)), 0.0);
    let secant2 = 1.0 + r2 * effects.vignetting.tan2_corner;
    return electrons * (left / (secant2 * secant2));
}
