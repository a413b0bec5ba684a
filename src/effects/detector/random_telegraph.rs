//! # Telegraph pixels (RTS)
//!
//! ## What it does
//!
//! A defect in the depletion region has two states, and in one of them it makes more charge: the dark current of such a pixel jumps
//! to and fro between two levels, after times that are drawn by chance (random telegraph signal). It is hot in some frames and like any other in the next.
//!
//! ## Equation
//!
//! A pixel has such a defect with probability r. While that is high, electrons += E·t·2^((T − T₀)/K), E drawn from an exponential law of
//! mean L. It stays low and high for times of exponential laws, of means τ_l·s and τ_h·s frames, ln s even within ±½·D·ln 10. That is: events come at the
//! rate λ = (1/τ_l + 1/τ_h)/s, and at each the state is drawn anew, high with probability τ_h/(τ_l + τ_h); the state in a frame is that of the last event,
//! and in frames k apart it is correlated by e^(−λk). Events are found by halving: whether 2²⁴ frames hold any, which half of them, and so on, each a number
//! of its own; so any frame can be made alone, and 2²⁴ frames later all begins anew.
//!
//! ## Parameters
//!
//! `rts_per_million` (r): 1 in a new detector to 10⁴ after years in orbit; `level_e_per_px_s` (L): mean step of the dark current at T₀, 10 to
//! 10³; `low_dwell_frames` (τ_l) and `high_dwell_frames` (τ_h): times from jump to jump over the time from frame to frame, 1 to 10⁴; `dwell_decades` (D): over
//! how many powers of ten they differ from pixel to pixel, 0 to 4; `reference_temperature_c` (T₀) and `doubling_k` (K) as for the dark current.
//!
//! ## Signature
//!
//! False stars that come and go on their pixel; a star that passes it is drawn towards it in some frames and not in others;
//! dark frames that do not take it away.
//!
//! ## Confused with
//!
//! Cosmic rays, which come once; variable stars, which move with the sky.
//!
//! ## Neglected
//!
//! Jumps during an exposure; times between frames that are not all the same; more than two levels; jumps that are faster when it is warm;
//! telegraph noise of the transistor, which does not grow with the exposure.
//!
//! ## Source
//!
//! S. Machlup, J. Appl. Phys. 25, 341 (1954), for the law; G. R. Hopkinson, V. Goiffon, A. Mohammadzadeh, IEEE TNS 55, 2197 (2008), for detectors.

use bytemuck::{Pod, Zeroable};

use super::dark_current::freed_e;
use crate::effects::ParameterSpec;
use crate::effects::pixel::defect_pixels::for_each_defect;
use crate::effects::pixel::math::{poly_ln, unit_interval};
use crate::effects::pixel::pattern::{exponential, fixed_words, word_limit};
use crate::effects::pixel::{ExposureContext, PixelEffect, Role, Stage, uniform_fields};
use crate::rng::StageKey;

/// Pixels that jump between two levels.
#[derive(Clone, Copy, Debug)]
pub struct RandomTelegraph;

/// What the shader gets. A word below a limit has the probability limit/2³².
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct RandomTelegraphUniforms {
    share_below: u32,
    high_share: f32,
    events_per_frame: f32,
    log_spread: f32,
    mean_e: f32,
}

/// Frames until all begins anew, as a power of two.
const LEVELS: u32 = 24;

/// Whether the defect of a pixel is high in a frame. The node n of a binary tree stands for the frames below it: node 1 for all of them, its halves
/// are the nodes 2n and 2n + 1, and the node 2^[`LEVELS`] + f is the frame f. Each has its own random words.
fn is_high(key: StageKey, pixel: u32, events_per_frame: f32, high_share: f32) -> bool {
    let quiet = |level: u32| exponential(-events_per_frame * (1_u32 << level) as f32);
    let words = |node: u32| fixed_words(key, pixel, node);
    // Which halves of a node with events hold some: the first, the second.
    let halves = |node: u32, level: u32| {
        let none = quiet(level - 1);
        let one_only = none / (1.0 + none);
        let chance = unit_interval(words(node)[1]);
        [chance <= 1.0 - one_only, chance >= one_only]
    };
    let frame = key.frame & ((1 << LEVELS) - 1);
    // The last node beside the way down to the frame that holds events before it, and its level.
    let (mut before, mut before_level) = (0, 0);
    let (mut node, mut level) = (1, LEVELS);
    let mut holds = unit_interval(words(1)[0]) >= quiet(LEVELS);
    while holds && level > 0 {
        let [in_first, in_second] = halves(node, level);
        level -= 1;
        let turns = frame >> level & 1;
        if turns == 1 && in_first {
            (before, before_level) = (2 * node, level);
        }
        holds = if turns == 1 { in_second } else { in_first };
        node = 2 * node + turns;
    }
    if !holds {
        (node, level) = (before, before_level);
        while level > 0 {
            let [_, in_second] = halves(node, level);
            level -= 1;
            node = 2 * node + u32::from(in_second);
        }
    }
    // Without any event the state is that from the beginning, of the words that are the pixel's own.
    let chance = if node == 0 { words(0)[3] } else { words(node)[2] };
    unit_interval(chance) < high_share
}

/// The twin.
fn random_telegraph(uniforms: &RandomTelegraphUniforms, key: StageKey, first_pixel: u32, pixels: &mut [f32]) {
    for_each_defect([uniforms.share_below, u32::MAX], key, first_pixel, pixels, |index, words, electrons| {
        let events_per_frame = uniforms.events_per_frame * exponential(uniforms.log_spread * (unit_interval(words[2]) - 0.5));
        if is_high(key, index, events_per_frame, uniforms.high_share) {
            *electrons += -poly_ln(unit_interval(words[1])) * uniforms.mean_e;
        }
    });
}

impl PixelEffect for RandomTelegraph {
    const ID: &'static str = "random-telegraph";
    const STAGE: Stage = Stage::Light;
    const ROLE: Role = Role::Adds;
    const PARAMETERS: &'static [ParameterSpec] = &[
        ParameterSpec { name: "rts_per_million", unit: "1e-6", typical: 500.0, range: (0.0, 5e5) },
        ParameterSpec { name: "level_e_per_px_s", unit: "e-/px/s", typical: 300.0, range: (0.0, 1e9) },
        ParameterSpec { name: "low_dwell_frames", unit: "frames", typical: 30.0, range: (0.01, 1e7) },
        ParameterSpec { name: "high_dwell_frames", unit: "frames", typical: 10.0, range: (0.01, 1e7) },
        ParameterSpec { name: "dwell_decades", unit: "", typical: 2.0, range: (0.0, 6.0) },
        ParameterSpec { name: "reference_temperature_c", unit: "°C", typical: 20.0, range: (-273.0, 200.0) },
        ParameterSpec { name: "doubling_k", unit: "K", typical: 6.5, range: (0.5, 100.0) },
    ];
    const DRAWS: bool = true;
    const RNG_STAGE: u32 = 8;
    const WGSL: &'static str = include_str!("../../../shaders/random_telegraph.wgsl");
    const SOURCE: &'static str = page_source!("random_telegraph.rs");
    type Uniforms = RandomTelegraphUniforms;
    const FIELDS: &'static [(&'static str, usize)] =
        uniform_fields!(RandomTelegraphUniforms { share_below, high_share, events_per_frame, log_spread, mean_e });

    fn uniforms(parameters: &[f64], exposure: &ExposureContext) -> RandomTelegraphUniforms {
        let [low, high] = [parameters[2], parameters[3]];
        RandomTelegraphUniforms {
            share_below: word_limit(1e-6 * parameters[0]),
            high_share: (high / (low + high)) as f32,
            events_per_frame: (1.0 / low + 1.0 / high) as f32,
            log_spread: (parameters[4] * std::f64::consts::LN_10) as f32,
            mean_e: freed_e(exposure, parameters[1], [parameters[5], parameters[6]]),
        }
    }
    fn apply(uniforms: &RandomTelegraphUniforms, key: StageKey, first_pixel: u32, pixels: &mut [f32]) {
        random_telegraph(uniforms, key, first_pixel, pixels);
    }
    fn identity() -> Option<Vec<f64>> {
        Some(vec![0.0, 300.0, 30.0, 10.0, 2.0, 20.0, 6.5])
    }
    fn least_e(_parameters: &[f64], _exposure: &ExposureContext, least_e: f64) -> f64 {
        least_e
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn is_high_in(frame: u32, pixel: u32, [low, high]: [f32; 2]) -> bool {
        let key = StageKey { seed: 11, frame, stage: RandomTelegraph::RNG_STAGE };
        is_high(key, pixel, 1.0 / low + 1.0 / high, high / (low + high))
    }

    /// Share of the time and correlation of frames k apart are those of the process that jumps at the rates 1/τ: the two-state chain of Machlup,
    /// within 4.5 standard errors over independent pixels. Frames near a border of the halving are as good as any.
    #[test]
    fn states_follow_the_law_of_the_telegraph() {
        const PIXELS: u32 = 20_000;
        for (dwell, first, apart) in [([3.0, 1.0], 0, 1), ([3.0, 1.0], (1 << 23) - 1, 1), ([30.0, 50.0], 4095, 20), ([1e4, 1e4], 777, 5000)]
        {
            let share = f64::from(dwell[1] / (dwell[0] + dwell[1]));
            let decay = (-f64::from(apart) * f64::from(1.0 / dwell[0] + 1.0 / dwell[1])).exp();
            let (mut high, mut both) = (0.0, 0.0);
            for pixel in 0..PIXELS {
                let one = is_high_in(first, pixel, dwell);
                high += f64::from(u8::from(one));
                both += f64::from(u8::from(one && is_high_in(first + apart, pixel, dwell)));
            }
            let near = |count: f64, share: f64, what: &str| {
                let sigma = (share * (1.0 - share) / f64::from(PIXELS)).sqrt();
                let found = count / f64::from(PIXELS);
                assert!((found - share).abs() < 4.5 * sigma, "{what} of {dwell:?} from {first}: {found} for {share}");
            };
            near(high, share, "high");
            near(both, share * (share + (1.0 - share) * decay), "both high");
        }
    }

    /// The mean number of frames from jump to jump, over long series of few pixels, and as many jumps up as down.
    #[test]
    fn dwell_times_are_those_asked_for() {
        let dwell = [12.0, 4.0];
        let (mut ups, mut downs, mut high, frames, pixels) = (0.0, 0.0, 0.0, 2000, 20);
        for pixel in 0..pixels {
            let states: Vec<bool> = (5000..5000 + frames).map(|frame| is_high_in(frame, pixel, dwell)).collect();
            ups += states.windows(2).filter(|pair| !pair[0] && pair[1]).count() as f64;
            downs += states.windows(2).filter(|pair| pair[0] && !pair[1]).count() as f64;
            high += states.iter().filter(|state| **state).count() as f64;
        }
        // What is sampled once a frame leaves high with the probability (1 − p)·(1 − e^−λ).
        let share = f64::from(dwell[1] / (dwell[0] + dwell[1]));
        let leaves = (1.0 - share) * (1.0 - (-f64::from(1.0 / dwell[0] + 1.0 / dwell[1])).exp());
        let expected = share * leaves * f64::from(frames * pixels);
        assert!(
            (downs - expected).abs() < 5.0 * expected.sqrt() && (ups - expected).abs() < 5.0 * expected.sqrt(),
            "{ups} {downs} {expected}"
        );
        assert!((high / f64::from(frames * pixels) - share).abs() < 0.02, "{high}");
    }

    /// Shares, steps and the spread of times in whole frames; two frames far apart have other pixels high, two close together mostly the same.
    #[test]
    fn pixels_jump_by_their_own_step() {
        let parameters = [50_000.0, 100.0, 200.0, 100.0, 0.0, 20.0, 6.5];
        let exposure = ExposureContext { exposure_s: 2.0, temperature_c: Some(26.5), ..ExposureContext::default() };
        let uniforms = RandomTelegraph::uniforms(&parameters, &exposure);
        let frame = |frame: u32| {
            let mut pixels = vec![3.0_f32; 100_000];
            random_telegraph(&uniforms, StageKey { seed: 4, frame, stage: RandomTelegraph::RNG_STAGE }, 0, &mut pixels);
            pixels
        };
        let [one, next, far] = [0, 1, 9000].map(frame);
        let levels: Vec<f64> = one.iter().filter(|e| **e > 3.0).map(|e| f64::from(*e) - 3.0).collect();
        let count = levels.len() as f64;
        assert!((count - 5000.0 / 3.0).abs() < 4.5 * (5000.0_f64 / 3.0).sqrt(), "{count}");
        // 100 e-/s for 2 s, twice as much at 6.5 K above the reference.
        assert!((levels.iter().sum::<f64>() / count - 400.0).abs() < 4.5 * 400.0 / count.sqrt());
        let same = |other: &[f32]| one.iter().zip(other).filter(|(a, b)| **a > 3.0 && a == b).count() as f64;
        assert!(same(&next) > 0.97 * count && same(&far) < 0.45 * count, "{} {} of {count}", same(&next), same(&far));
    }
}
