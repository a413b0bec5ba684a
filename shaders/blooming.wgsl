// Excess charge along the columns. Twin and page: src/effects/detector/blooming.rs

struct BloomingUniforms {
    full_well_e: f32,
    half_kept: f32,
}

fn blooming(electrons: f32, pixel: Pixel, carry: ptr<function, vec4<f32>>) -> f32 {
    let half = effects.blooming.half_kept;
    let share = select(1.0, half, SWEEP == 0u);
    let stays = select(0.0, half, SWEEP == 0u);
    let held = min(electrons, effects.blooming.full_well_e);
    let excess = electrons - held;
    let room = effects.blooming.full_well_e - held;
    let filled = min((*carry).x, room);
    (*carry).x = (*carry).x - filled + share * excess;
    return held + filled + stays * excess;
}
