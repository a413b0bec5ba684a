//! What moves charge between pixels: a pass over the whole frame, in one of two shapes that a GPU can run.
//!
//! - A **line pass** ([`LinePass`]) goes along lines: every column, or every row, is walked pixel by pixel, and a carry of four numbers goes
//!   along. Transfer of charge, blooming and settling of the video signal are such recurrences. Lines know nothing of each other, so all are
//!   walked at once; the carry is kept in a buffer where a line is walked in parts. A pass may take several sweeps.
//! - A **neighbour pass** ([`NeighbourPass`]) makes every pixel anew from the pixels around it in the frame as it was.
//!
//! On the CPU both run on all cores and give the same bytes at any number of threads.

use bytemuck::Pod;
use rayon::prelude::*;

use super::{AnyPixelEffect, ExposureContext, Role, Stage, Work};
use crate::effects::ParameterSpec;

/// Along which lines a sweep goes, and from which end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sweep {
    /// Columns (from the first row on) or rows (from the first column on).
    pub along: Along,
    /// Whether it begins at the far end.
    pub backward: bool,
}

/// The lines of a sweep.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Along {
    /// Every column by itself.
    Columns,
    /// Every row by itself.
    Rows,
}

/// The shape of a pass.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PassShape {
    /// A recurrence along lines, in these sweeps.
    Lines(&'static [Sweep]),
    /// Each pixel from its neighbours, so many times over.
    Neighbours {
        /// How often the frame is made anew.
        sweeps: usize,
    },
}

/// What goes along a line from pixel to pixel; zero where the line begins.
pub type Carry = [f32; 4];

/// Columns that are walked together: a row's part of them is one or two lines of a cache.
pub const COLUMNS_TOGETHER: usize = 32;

/// The carries of columns that are walked together, number by number.
pub type Carries = [[f32; COLUMNS_TOGETHER]; 4];

/// How far up and down a neighbour pass may look, px. Along a row it may look anywhere.
pub const MAX_ROWS_AWAY: usize = 16;

/// A whole frame, row by row, and a second one to work in.
#[derive(Debug)]
pub struct FrameBuffer<'a> {
    /// Columns.
    pub width: usize,
    /// The frame.
    pub electrons: &'a mut Vec<f32>,
    /// Space of a twin's own, kept between calls.
    pub scratch: &'a mut Vec<f32>,
}

/// A frame as a neighbour pass reads it.
#[derive(Clone, Copy, Debug)]
pub struct Source<'a> {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    electrons: &'a [f32],
}

impl<'a> Source<'a> {
    /// The row that is `below` rows below row `y`; beyond the frame's edge the outermost one.
    #[must_use]
    pub fn row(&self, y: usize, below: isize) -> &'a [f32] {
        let y = y.saturating_add_signed(below).min(self.height - 1);
        &self.electrons[y * self.width..][..self.width]
    }
}

/// What every pass says of itself; the meaning is that of [`super::PixelEffect`].
pub trait PassHead: Sync {
    /// Its id in files. With `_` for `-` it is the name of its twin and of its WGSL function.
    const ID: &'static str;
    /// Parameters that show more of it than the typical ones on the small frame of its picture.
    const DEMO_SIZES: &'static [(&'static str, f64)] = &[];
    /// Where it acts.
    const STAGE: Stage;
    /// What it does to the light of a star.
    const ROLE: Role = Role::Shapes;
    /// Its parameters.
    const PARAMETERS: &'static [ParameterSpec];
    /// Whether the frame holds as much charge after it as before, but for what leaves over an edge.
    const CONSERVES_CHARGE: bool;
    /// The text of its shader.
    const WGSL: &'static str;
    /// The text of its source file, whose head is its page.
    const SOURCE: &'static str;
    /// What the parameters become on their way to the pixels.
    type Uniforms: Pod + Sync;
    /// Name and offset in bytes of each member of [`Self::Uniforms`].
    const FIELDS: &'static [(&'static str, usize)];

    /// Uniforms from parameters in the order of [`Self::PARAMETERS`].
    fn uniforms(parameters: &[f64], exposure: &ExposureContext) -> Self::Uniforms;
    /// Parameters with which it changes nothing, if there are any.
    fn identity() -> Option<Vec<f64>>;
}

/// What the author of a line pass writes. Its shader has `fn id(electrons: f32, pixel: Pixel, carry: ptr<function, vec4<f32>>) -> f32`, with
/// the number of the sweep as the constant `SWEEP`.
pub trait LinePass: PassHead {
    /// The sweeps, one after the other.
    const SWEEPS: &'static [Sweep];
    /// The CPU twin: one pixel's step. `place` is its column and its row.
    fn step(uniforms: &Self::Uniforms, sweep: usize, place: [usize; 2], electrons: f32, carry: &mut Carry) -> f32;

    /// A step of columns side by side, from the one at `place`: the same as [`Self::step`] of each. A pass whose step is long may say it anew, so that
    /// neighbours are vectorised.
    fn step_row(uniforms: &Self::Uniforms, sweep: usize, place: [usize; 2], row: &mut [f32], carries: &mut Carries) {
        let [first, second, third, fourth] = carries;
        let carries = first.iter_mut().zip(second).zip(third).zip(fourth);
        for (i, (electrons, (((first, second), third), fourth))) in row.iter_mut().zip(carries).enumerate() {
            let mut carry = [*first, *second, *third, *fourth];
            *electrons = Self::step(uniforms, sweep, [place[0] + i, place[1]], *electrons, &mut carry);
            [*first, *second, *third, *fourth] = carry;
        }
    }
}

/// What the author of a neighbour pass writes. Its shader has `fn id(pixel: Pixel) -> f32`, reads with `source_at(x, y)` (integers, clamped to
/// the frame) and has the number of the sweep as the constant `SWEEP`.
pub trait NeighbourPass: PassHead {
    /// How often the frame is made anew.
    const SWEEPS: usize = 1;
    /// The CPU twin: makes row `y` from the frame as it was. It looks at most [`MAX_ROWS_AWAY`] rows up and down.
    fn row(uniforms: &Self::Uniforms, sweep: usize, source: &Source<'_>, y: usize, row: &mut [f32]);
}

/// A line pass as the registry holds it.
#[derive(Clone, Copy, Debug)]
pub struct Lines<P>(pub P);

/// A neighbour pass as the registry holds it.
#[derive(Clone, Copy, Debug)]
pub struct Neighbours<P>(pub P);

fn walk<P: LinePass>(uniforms: &P::Uniforms, frame: &mut FrameBuffer<'_>) {
    let width = frame.width;
    for (number, sweep) in P::SWEEPS.iter().enumerate() {
        match sweep.along {
            Along::Columns => {
                let mut strips: Vec<Vec<&mut [f32]>> = (0..width.div_ceil(COLUMNS_TOGETHER)).map(|_| Vec::new()).collect();
                for row in frame.electrons.chunks_exact_mut(width) {
                    for (strip, piece) in strips.iter_mut().zip(row.chunks_mut(COLUMNS_TOGETHER)) {
                        strip.push(piece);
                    }
                }
                strips.par_iter_mut().enumerate().for_each(|(strip_number, strip)| {
                    let mut carries = Carries::default();
                    let height = strip.len();
                    for turn in 0..height {
                        let y = if sweep.backward { height - 1 - turn } else { turn };
                        P::step_row(uniforms, number, [strip_number * COLUMNS_TOGETHER, y], strip[y], &mut carries);
                    }
                });
            }
            Along::Rows => frame.electrons.par_chunks_exact_mut(width).enumerate().for_each(|(y, row)| {
                let mut carry = Carry::default();
                for turn in 0..width {
                    let x = if sweep.backward { width - 1 - turn } else { turn };
                    row[x] = P::step(uniforms, number, [x, y], row[x], &mut carry);
                }
            }),
        }
    }
}

fn make_anew<P: NeighbourPass>(uniforms: &P::Uniforms, frame: &mut FrameBuffer<'_>) {
    let width = frame.width;
    frame.scratch.resize(frame.electrons.len(), 0.0);
    for sweep in 0..P::SWEEPS {
        std::mem::swap(frame.electrons, frame.scratch);
        let source = Source { width, height: frame.scratch.len() / width, electrons: frame.scratch };
        frame.electrons.par_chunks_exact_mut(width).enumerate().for_each(|(y, row)| P::row(uniforms, sweep, &source, y, row));
    }
}

/// All of [`AnyPixelEffect`] but the work and its shape, by way of [`PassHead`].
macro_rules! head {
    () => {
        fn id(&self) -> &'static str {
            P::ID
        }
        fn demo_sizes(&self) -> &'static [(&'static str, f64)] {
            P::DEMO_SIZES
        }
        fn stage(&self) -> Stage {
            P::STAGE
        }
        fn role(&self) -> Role {
            P::ROLE
        }
        fn parameters(&self) -> &'static [ParameterSpec] {
            P::PARAMETERS
        }
        fn rng_stage(&self) -> u32 {
            0
        }
        fn wgsl(&self) -> &'static str {
            P::WGSL
        }
        fn source(&self) -> &'static str {
            P::SOURCE
        }
        fn fields(&self) -> &'static [(&'static str, usize)] {
            P::FIELDS
        }
        fn uniforms(&self, parameters: &[f64], exposure: &ExposureContext) -> Vec<u8> {
            bytemuck::bytes_of(&P::uniforms(parameters, exposure)).to_vec()
        }
        fn identity(&self) -> Option<Vec<f64>> {
            P::identity()
        }
        fn conserves_charge(&self) -> bool {
            P::CONSERVES_CHARGE
        }
    };
}

impl<P: LinePass> AnyPixelEffect for Lines<P> {
    head!();
    fn work(&self) -> Work {
        Work::Frame(PassShape::Lines(P::SWEEPS), |uniforms, frame| walk::<P>(&bytemuck::pod_read_unaligned(uniforms), frame))
    }
}

impl<P: NeighbourPass> AnyPixelEffect for Neighbours<P> {
    head!();
    fn work(&self) -> Work {
        let shape = PassShape::Neighbours { sweeps: P::SWEEPS };
        Work::Frame(shape, |uniforms, frame| make_anew::<P>(&bytemuck::pod_read_unaligned(uniforms), frame))
    }
}
