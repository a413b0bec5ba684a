// Point spread from tables. Twin and page: src/effects/optics/atlas_psf.rs

// The four weights of the cubic B-spline at the share u of a step behind the second of its knots.
fn spline_weights(u: f32) -> vec4<f32> {
    let v = 1.0 - u;
    return vec4<f32>(
        v * v * v * (1.0 / 6.0),
        (3.0 * u - 6.0) * u * u * (1.0 / 6.0) + 2.0 / 3.0,
        ((3.0 - 3.0 * u) * u + 3.0) * u * (1.0 / 6.0) + 1.0 / 6.0,
        u * u * u * (1.0 / 6.0),
    );
}

// Share of the light in the pixel whose centre lies (dx, dy) px from the star.
fn atlas_psf(star: Star, dx: f32, dy: f32) -> f32 {
    let oversampling = i32(atlas[0]);
    let side = i32(atlas[1]);
    let middle = side / 2;
    let whole_x = floor(dx);
    let whole_y = floor(dy);
    let column = i32(whole_x) + middle;
    let row = i32(whole_y) + middle;
    if (column < 1 || row < 1 || column + 2 > side - 1 || row + 2 > side - 1) {
        return 0.0;
    }
    let fine_x = (dx - whole_x) * f32(oversampling);
    let fine_y = (dy - whole_y) * f32(oversampling);
    let phase_x = min(i32(fine_x), oversampling - 1);
    let phase_y = min(i32(fine_y), oversampling - 1);
    let across = spline_weights(fine_x - f32(phase_x));
    let down = spline_weights(fine_y - f32(phase_y));
    var sum = 0.0;
    for (var n = 0u; n < star.nodes; n++) {
        let node = select(star.node_high[n & 3u], star.node_low[n & 3u], n < 4u);
        let weight = select(star.weight_high[n & 3u], star.weight_low[n & 3u], n < 4u);
        let table = 4 + i32(node) * oversampling * oversampling * side * side;
        for (var j = 0; j < 4; j++) {
            let y = phase_y + j - 1;
            let carry_y = select(select(0, 1, y >= oversampling), -1, y < 0);
            let line = table + (y - carry_y * oversampling) * oversampling * side * side + (row + carry_y) * side;
            for (var k = 0; k < 4; k++) {
                let x = phase_x + k - 1;
                let carry_x = select(select(0, 1, x >= oversampling), -1, x < 0);
                let at = line + (x - carry_x * oversampling) * side * side + column + carry_x;
                sum += weight * (down[j] * across[k]) * atlas[at];
            }
        }
    }
    return sum;
}
