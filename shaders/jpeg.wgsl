// Rounding of the frequencies of blocks. Twin and page: src/effects/detector/jpeg.rs

struct JpegUniforms {
    table_scale_dn: f32,
}

// Table K.1 of the standard, row by row of vertical frequency.
var<private> luminance: array<f32, 64> = array<f32, 64>(
    16.0, 11.0, 10.0, 16.0, 24.0, 40.0, 51.0, 61.0,
    12.0, 12.0, 14.0, 19.0, 26.0, 58.0, 60.0, 55.0,
    14.0, 13.0, 16.0, 24.0, 40.0, 57.0, 69.0, 56.0,
    14.0, 17.0, 22.0, 29.0, 51.0, 87.0, 80.0, 62.0,
    18.0, 22.0, 37.0, 56.0, 68.0, 109.0, 103.0, 77.0,
    24.0, 35.0, 55.0, 64.0, 81.0, 104.0, 113.0, 92.0,
    49.0, 64.0, 78.0, 87.0, 103.0, 121.0, 120.0, 101.0,
    72.0, 92.0, 95.0, 98.0, 112.0, 100.0, 103.0, 99.0,
);

// Element of the orthonormal cosine transform of `size` numbers: frequency k at place i.
fn basis(size: u32, k: u32, i: u32) -> f32 {
    let turn = (2u * i + 1u) * k * (0x40000000u / size);
    return sqrt(select(2.0, 1.0, k == 0u) / f32(size)) * cos_turn(turn);
}

fn jpeg(pixel: Pixel) -> f32 {
    let is_row = SWEEP == 0u || SWEEP == 3u;
    let x = pixel.x & 7u;
    let y = pixel.y & 7u;
    let first = vec2<u32>(pixel.x - x, pixel.y - y);
    let size = min(8u, select(around.height - first.y, frame.width - first.x, is_row));
    let at = select(y, x, is_row);
    var sum = 0.0;
    for (var k = 0u; k < size; k++) {
        let place = select(vec2<u32>(pixel.x, first.y + k), vec2<u32>(first.x + k, pixel.y), is_row);
        let element = basis(size, select(k, at, SWEEP < 2u), select(at, k, SWEEP < 2u));
        sum += source_at(i32(place.x), i32(place.y)) * element;
    }
    if (SWEEP == 1u) {
        let quantum = effects.jpeg.table_scale_dn * luminance[y * 8u + x];
        return quantum * floor(sum / quantum + 0.5);
    }
    return select(sum, clamp(floor(sum + 0.5), 0.0, 65535.0), SWEEP == 3u);
}
