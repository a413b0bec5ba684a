//! The stages of a diagnosis, each a value made from the one before:
//!
//! ```text
//! Baseline → Screened → Selected → Validated → Solved → Judged → Reported → Diagnosis
//! ```
//! A stage holds what it decided and never changes what an earlier one did. So each can be asked by itself what it holds.

mod baseline;
mod judged;
mod report;
mod screened;
mod selected;
mod solved;
mod validated;

#[cfg(test)]
mod tests;

pub(super) use baseline::Baseline;
pub(super) use judged::Judged;
pub(super) use report::Reported;
pub(super) use screened::Screened;
pub(super) use selected::Selected;
pub(super) use solved::Solved;
pub(super) use validated::Validated;
