// Offsets of rows and columns. Twin and page: src/effects/detector/banding.rs

struct BandingUniforms {
    row_sigma_e: f32,
    column_sigma_e: f32,
    width: u32,
}

fn banding(electrons: f32, pixel: Pixel) -> f32 {
    let of_row = words(pixel.y, BANDING_STAGE, 0u);
    let of_column = fixed_words(pixel.x, BANDING_STAGE, 0u);
    let with_row = electrons + effects.banding.row_sigma_e * standard_normal(of_row.x, of_row.y);
    return with_row + effects.banding.column_sigma_e * standard_normal(of_column.x, of_column.y);
}
