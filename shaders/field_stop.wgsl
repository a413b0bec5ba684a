// A round end of the field. Twin and page: src/effects/optics/field_stop.rs

struct FieldStopUniforms {
    centre_x_px: f32,
    centre_y_px: f32,
    outer_px: f32,
    per_px: f32,
    width: u32,
}

fn field_stop(electrons: f32, pixel: Pixel) -> f32 {
    let radius_px = sqrt(radius2_px(pixel, effects.field_stop.centre_x_px, effects.field_stop.centre_y_px));
    return electrons * clamp((effects.field_stop.outer_px - radius_px) * effects.field_stop.per_px, 0.0, 1.0);
}
