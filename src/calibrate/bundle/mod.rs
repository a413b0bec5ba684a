//! Bundle adjustment: camera and attitudes solved together, from the positions of single stars.
//!
//! Every star image counts for itself, weighted by the covariance of its measurement; an attitude is a rotation and nothing else (a free
//! translation would trade with the focal length); identifications are right or wrong with a probability that comes out of the fit.
//!
//! | file | what it holds |
//! |---|---|
//! | [`mod@solve_for`] | names → parameters of the model |
//! | [`problem`] | star images, and their linearisation |
//! | [`mod@reference`] | the reference model's derivatives in closed form |
//! | [`mod@pose`] | the problem that options and points pose |
//! | [`consensus`] | focal length and attitudes to begin with, whatever is wrong |
//! | [`start`] | from the ground values to a solution |
//! | [`solved`] | a solution |
//! | [`noise`] | weights, scale, share of wrong identifications |
//! | [`normal`] | normal equations, attitudes eliminated |
//! | [`adjust`] | the iteration |
//! | [`mapping`] | the map over the frame: uncertainty, coverage |
//! | [`memory`] | what earlier solutions know, in constant size |
//! | [`known`] | what they know of the camera |
//! | [`mod@update`] | new frames with what earlier solutions know |
//! | [`change`] | whether these are of the same camera |
//! | [`profile`] | standard errors of what is hardly determined, from the cost itself |
//! | [`held_out`] | cross-validation without solving anew |
//! | [`groups`] | what is tried together, by the reference model and by each effect |
//! | [`selection`] | which parameters the data support |
//! | [`worse`] | why a frame is worse than the others |
//! | [`determined`] | what the star images determine |
//! | [`summary`] | the result |
//! | [`method`] | all of it |
//!
//! Source: Triggs et al., "Bundle adjustment: a modern synthesis" (2000), for the elimination; Brown (1971) for self-calibration.

mod adjust;
mod change;
mod consensus;
mod determined;
mod groups;
mod held_out;
mod known;
mod mapping;
mod memory;
mod method;
mod noise;
mod normal;
mod pose;
mod problem;
mod profile;
mod reference;
mod selection;
mod solve_for;
mod solved;
mod start;
mod summary;
mod update;
mod worse;

pub(super) use adjust::{Adjusted, Run, scales};
pub(crate) use consensus::optimal_rotation;
pub(super) use known::{Known, inverse};
pub(super) use mapping::map_sigma_px;
pub(super) use memory::{CLASSES, NoiseMemory};
pub(super) use method::calibrate;
pub(super) use noise::Noise;
pub(super) use normal::MAX_LOCAL as MAX_FRAME_PARAMETERS;
pub(super) use pose::{drop_without_effect, indices, names};
pub(super) use problem::{Attitudes, Exposure, Prior, Problem, State};
pub(super) use solve_for::{checked as check_name, solve_for};
pub(super) use solved::Solved;
pub(super) use start::solve;
pub(super) use update::{Updated, update};

use pose::{is_reference, pose};
