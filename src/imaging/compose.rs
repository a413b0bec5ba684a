//! Shader composition: one program that holds what is switched on and nothing else, since some drivers run both sides of every branch.

use std::fmt::Write;

use super::tiles::TILE_PX;
use crate::effects::pixel::lanes::QUAD_PX;
use crate::effects::pixel::pass::{Along, PassShape};
use crate::effects::pixel::{AnyPixelEffect, Psf2d, SeparablePsf};

const FRAME: &str = include_str!("../../shaders/lib/frame.wgsl");
const MATH: &str = include_str!("../../shaders/lib/math.wgsl");
const RNG: &str = include_str!("../../shaders/lib/rng.wgsl");
const PATTERN: &str = include_str!("../../shaders/lib/pattern.wgsl");
const WALK: &str = include_str!("../../shaders/lib/walk.wgsl");
const NEIGHBOURS: &str = include_str!("../../shaders/lib/neighbours.wgsl");
const SOURCE_ONE: &str = include_str!("../../shaders/lib/source_one.wgsl");
const SOURCE_THREE: &str = include_str!("../../shaders/lib/source_three.wgsl");
const COLLECT: &str = include_str!("../../shaders/lib/collect.wgsl");
const COLLECT_PLANE: &str = include_str!("../../shaders/lib/collect_plane.wgsl");
const QUADS_TILED: &str = include_str!("../../shaders/lib/quads_tiled.wgsl");
const QUADS_WHOLE: &str = include_str!("../../shaders/lib/quads_whole.wgsl");
const QUADS_CUT: &str = include_str!("../../shaders/lib/quads_cut.wgsl");
const TO_COUNTS: &str = include_str!("../../shaders/lib/to_counts.wgsl");
const TO_ELECTRONS: &str = include_str!("../../shaders/lib/to_electrons.wgsl");
const JOIN: &str = include_str!("../../shaders/join.wgsl");
const MOSAIC: &str = include_str!("../../shaders/mosaic.wgsl");

/// Uniforms of effects begin at multiples of this many bytes: WGSL asks it of a struct inside a uniform struct.
pub(super) const UNIFORM_ALIGNMENT: usize = 16;

/// What the last program of a frame writes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Output {
    /// Electrons as f32.
    Electrons,
    /// Counts as u16, two in a word.
    Counts,
}

/// The program that collects the stars' light in a frame of this width; its entry points are `profiles` and `collect`. `goes_on`: to what the
/// pixels hold already.
#[must_use]
pub fn collect_program(spread: &dyn SeparablePsf, width_px: usize, goes_on: bool) -> String {
    let quads = match width_px {
        width_px if width_px.is_multiple_of(TILE_PX) => QUADS_TILED,
        width_px if width_px.is_multiple_of(QUAD_PX) => QUADS_WHOLE,
        _ => QUADS_CUT,
    };
    let collect = COLLECT.replace("POINT_SPREAD_quad(star,", &format!("{}_quad(star,", spread.id()));
    [FRAME, MATH, spread.wgsl(), quads, &format!("const GOES_ON = {goes_on};"), &collect].join("\n")
}

/// The program that adds the light of a plane point spread; its entry point is `collect_plane`.
#[must_use]
pub fn collect_plane_program(spread: &dyn Psf2d) -> String {
    [FRAME, MATH, spread.wgsl_library(), spread.wgsl(), &COLLECT_PLANE.replace("SHARE)", &format!("{})", spread.wgsl_share()))].join("\n")
}

/// The program that sends every pixel through the effects in their order; its entry point is `finish`. `may_be_faint`: whether pixels can hold less
/// than what an effect has a way of its own for ([`AnyPixelEffect::faint_below_e`]).
#[must_use]
pub fn chain_program(effects: &[&dyn AnyPixelEffect], may_be_faint: bool, output: Output) -> String {
    let calls: String = effects.iter().map(|effect| call(*effect)).collect();
    let chain = format!("{CHAIN_HEAD}{calls}    return value;\n}}\n");
    let mut head = ELECTRONS_IN_QUADS.to_owned() + &head(effects);
    for effect in effects.iter().filter(|effect| effect.faint_below_e().is_some()) {
        let _ = writeln!(head, "const {}_MAY_BE_FAINT = {may_be_faint};", effect.stem().to_uppercase());
    }
    let mut parts = vec![FRAME, MATH, RNG, PATTERN, &head];
    parts.extend(effects.iter().map(|effect| effect.wgsl()));
    parts.push(&chain);
    parts.push(match output {
        Output::Electrons => TO_ELECTRONS,
        Output::Counts => TO_COUNTS,
    });
    parts.join("\n")
}

/// The program that joins pixels, so many along each side; its entry points are `join` for electrons and `join_counts`.
#[must_use]
pub fn join_program(factor: usize) -> String {
    format!("const FACTOR = {factor}u;\n{JOIN}")
}

/// The program that puts light behind the filters of a mosaic; its entry point is `mosaic`.
#[must_use]
pub fn mosaic_program() -> String {
    [FRAME, MOSAIC].join("\n")
}

/// How the chain begins: with four neighbours. Bands begin with whole quads.
const CHAIN_HEAD: &str = "fn chain(before: vec4<f32>, quad_of_band: u32) -> vec4<f32> {
    let first = pixel_at(4u * quad_of_band);
    let second = next_pixel(first);
    let third = next_pixel(second);
    let fourth = next_pixel(third);
    let quad = first.index / 4u;
    var value = before;
";

/// The call of an effect for four pixels.
fn call(effect: &dyn AnyPixelEffect) -> String {
    let id = effect.stem();
    if effect.wgsl().contains(&format!("fn {id}_quad(")) {
        return format!("    value = {id}_quad(value, quad);\n");
    }
    format!("    value = vec4<f32>({id}(value.x, first), {id}(value.y, second), {id}(value.z, third), {id}(value.w, fourth));\n")
}

/// The frame as programs change it.
const ELECTRONS: &str = "@group(0) @binding(2) var<storage, read_write> electrons: array<f32>;\n";

/// The same in fours.
const ELECTRONS_IN_QUADS: &str = "@group(0) @binding(2) var<storage, read_write> electrons: array<vec4<f32>>;\n";

/// Random stages and uniforms of effects.
fn head(effects: &[&dyn AnyPixelEffect]) -> String {
    let (mut head, mut members) = (String::new(), String::new());
    for effect in effects {
        let id = effect.stem();
        if effect.rng_stage() != 0 {
            let _ = writeln!(head, "const {}_STAGE = {}u;", id.to_uppercase(), effect.rng_stage());
        }
        if !effect.fields().is_empty() {
            let _ = writeln!(members, "    @align({UNIFORM_ALIGNMENT}) {id}: {},", uniforms_name(&id));
        }
    }
    if !members.is_empty() {
        let _ = writeln!(head, "struct Effects {{\n{members}}}\n@group(0) @binding(1) var<uniform> effects: Effects;");
    }
    head
}

/// The program of a sweep of a pass.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PassProgram {
    /// Its text.
    pub wgsl: String,
    /// Its entry point.
    pub entry: &'static str,
}

/// The programs of a pass, one for each of its sweeps. `in_bands`: the frame lies in several buffers.
#[must_use]
pub fn pass_programs(effect: &dyn AnyPixelEffect, shape: PassShape, in_bands: bool) -> Vec<PassProgram> {
    let head = head(&[effect]);
    let program = |sweep: usize, parts: &[&str], shape: &str, entry| {
        let constants = format!("const SWEEP = {sweep}u;");
        let shape = shape.replace("STEP(", &format!("{}(", effect.stem()));
        let wgsl = [&[FRAME, MATH, RNG, PATTERN, &head, &constants], parts, &[effect.wgsl(), &shape]].concat().join("\n");
        PassProgram { wgsl, entry }
    };
    match shape {
        PassShape::Lines(sweeps) => (0..)
            .zip(sweeps)
            .map(|(number, sweep)| {
                let (rows, backward) = (sweep.along == Along::Rows, sweep.backward);
                let constants = format!("const ALONG_ROWS = {rows};\nconst BACKWARD = {backward};");
                program(number, &[ELECTRONS, &constants], WALK, "walk")
            })
            .collect(),
        PassShape::Neighbours { sweeps } => {
            let source = if in_bands { SOURCE_THREE } else { SOURCE_ONE };
            (0..sweeps).map(|number| program(number, &[source], NEIGHBOURS, "make_anew")).collect()
        }
    }
}

/// The name of an effect's uniforms in WGSL: `read_noise` → `ReadNoiseUniforms`.
#[must_use]
pub fn uniforms_name(id: &str) -> String {
    let words = id.split('_').map(|word| word[..1].to_uppercase() + &word[1..]);
    words.collect::<String>() + "Uniforms"
}
