// What every shader knows of the frame. The renderer works in bands of whole rows of tiles, so that no buffer is too large.

struct Frame {
    width: u32,
    // Rows of the band, and the first of them in the frame.
    rows: u32,
    first_row: u32,
    // Columns of tiles.
    tile_columns: u32,
    frame_index: u32,
    seed_low: u32,
    seed_high: u32,
    // Pixels of the band.
    pixels: u32,
}

struct Pixel {
    // Index in the whole frame, row by row.
    index: u32,
    x: u32,
    y: u32,
}

@group(0) @binding(0) var<uniform> frame: Frame;

// The pixel with this index in the band.
fn pixel_at(index: u32) -> Pixel {
    let row = index / frame.width;
    return Pixel(index + frame.first_row * frame.width, index - row * frame.width, row + frame.first_row);
}

// The square of its distance from a point, px².
fn radius2_px(pixel: Pixel, x_px: f32, y_px: f32) -> f32 {
    let dx = f32(pixel.x) - x_px;
    let dy = f32(pixel.y) - y_px;
    return dx * dx + dy * dy;
}

// The pixel after this one.
fn next_pixel(pixel: Pixel) -> Pixel {
    let wraps = pixel.x + 1u == frame.width;
    return Pixel(pixel.index + 1u, select(pixel.x + 1u, 0u, wraps), pixel.y + select(0u, 1u, wraps));
}
