// Charge that is trapped and let go. Twin and page: src/effects/detector/charge_transfer_inefficiency.rs

struct ChargeTransferInefficiencyUniforms {
    traps_per_px: f32,
    released: f32,
    second_traps_per_px: f32,
    second_released: f32,
    serial_traps_per_px: f32,
    serial_released: f32,
    per_full_well: f32,
    cloud_exponent: f32,
    capture: f32,
}

const MIN_E = 0.01;

// Electrons of the packet and of the traps after one kind of traps, of which the whole way has `traps` and `held` are full.
fn trap(traps: f32, released: f32, electrons: f32, held: f32) -> vec2<f32> {
    let filling = electrons * effects.charge_transfer_inefficiency.per_full_well;
    let exponent = effects.charge_transfer_inefficiency.cloud_exponent;
    let met = traps * power(filling, exponent);
    let certain = 1.0 - exponential(-effects.charge_transfer_inefficiency.capture * power(filling, 1.0 - exponent));
    let could = (met - held) / (met / max(electrons, MIN_E) + 1.0) * certain;
    let taken = select(0.0, max(could, 0.0), electrons > MIN_E);
    let full = held + taken;
    let let_go = full * released;
    return vec2<f32>(electrons - taken + let_go, full - let_go);
}

fn charge_transfer_inefficiency(electrons: f32, pixel: Pixel, carry: ptr<function, vec4<f32>>) -> f32 {
    if (SWEEP == 1u) {
        let way = f32(pixel.x + 1u);
        let after = trap(
            effects.charge_transfer_inefficiency.serial_traps_per_px * way,
            effects.charge_transfer_inefficiency.serial_released,
            electrons,
            (*carry).x,
        );
        (*carry).x = after.y;
        return after.x;
    }
    let way = f32(pixel.y + 1u);
    let first = trap(
        effects.charge_transfer_inefficiency.traps_per_px * way,
        effects.charge_transfer_inefficiency.released,
        electrons,
        (*carry).x,
    );
    let second = trap(
        effects.charge_transfer_inefficiency.second_traps_per_px * way,
        effects.charge_transfer_inefficiency.second_released,
        first.x,
        (*carry).y,
    );
    (*carry).x = first.y;
    (*carry).y = second.y;
    return second.x;
}
