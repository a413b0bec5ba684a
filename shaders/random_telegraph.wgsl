// Pixels that jump between two levels. Twin and page: src/effects/detector/random_telegraph.rs

struct RandomTelegraphUniforms {
    share_below: u32,
    high_share: f32,
    events_per_frame: f32,
    log_spread: f32,
    mean_e: f32,
}

// Frames until all begins anew, as a power of two.
const TELEGRAPH_LEVELS: u32 = 24u;

fn telegraph_quiet(events_per_frame: f32, level: u32) -> f32 {
    return exponential(-events_per_frame * f32(1u << level));
}

// Which halves of a node with events hold some: the first, the second.
fn telegraph_halves(pixel_index: u32, node: u32, level: u32, events_per_frame: f32) -> vec2<bool> {
    let none = telegraph_quiet(events_per_frame, level - 1u);
    let one_only = none / (1.0 + none);
    let chance = unit_interval(fixed_words(pixel_index, RANDOM_TELEGRAPH_STAGE, node).y);
    return vec2<bool>(chance <= 1.0 - one_only, chance >= one_only);
}

fn telegraph_is_high(pixel_index: u32, events_per_frame: f32) -> bool {
    let frame_number = frame.frame_index & ((1u << TELEGRAPH_LEVELS) - 1u);
    var before = 0u;
    var before_level = 0u;
    var node = 1u;
    var level = TELEGRAPH_LEVELS;
    let first_chance = unit_interval(fixed_words(pixel_index, RANDOM_TELEGRAPH_STAGE, 1u).x);
    var holds = first_chance >= telegraph_quiet(events_per_frame, TELEGRAPH_LEVELS);
    while (holds && level > 0u) {
        let halves = telegraph_halves(pixel_index, node, level, events_per_frame);
        level -= 1u;
        let turns = (frame_number >> level) & 1u;
        if (turns == 1u && halves.x) {
            before = 2u * node;
            before_level = level;
        }
        holds = select(halves.x, halves.y, turns == 1u);
        node = 2u * node + turns;
    }
    if (!holds) {
        node = before;
        level = before_level;
        while (level > 0u) {
            let halves = telegraph_halves(pixel_index, node, level, events_per_frame);
            level -= 1u;
            node = 2u * node + select(0u, 1u, halves.y);
        }
    }
    let own = fixed_words(pixel_index, RANDOM_TELEGRAPH_STAGE, node);
    return unit_interval(select(own.z, own.w, node == 0u)) < effects.random_telegraph.high_share;
}

fn random_telegraph(electrons: f32, pixel: Pixel) -> f32 {
    let random = fixed_words(pixel.index, RANDOM_TELEGRAPH_STAGE, 0u);
    if (random.x >= effects.random_telegraph.share_below) {
        return electrons;
    }
    let spread = exponential(effects.random_telegraph.log_spread * (unit_interval(random.z) - 0.5));
    let step = -poly_ln(unit_interval(random.y)) * effects.random_telegraph.mean_e;
    let is_high = telegraph_is_high(pixel.index, effects.random_telegraph.events_per_frame * spread);
    return electrons + select(0.0, step, is_high);
}
