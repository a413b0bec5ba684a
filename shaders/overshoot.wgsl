// A signal that has not settled. Twin and page: src/effects/detector/overshoot.rs

struct OvershootUniforms {
    tail_relative: f32,
    forgets: f32,
}

fn overshoot(electrons: f32, pixel: Pixel, carry: ptr<function, vec4<f32>>) -> f32 {
    let memory = select(electrons, (*carry).x, (*carry).y > 0.0);
    *carry = vec4<f32>(memory + (electrons - memory) * effects.overshoot.forgets, 1.0, 0.0, 0.0);
    return electrons + effects.overshoot.tail_relative * (memory - electrons);
}
