//! The system under test: how frames reach it and answers come back.

mod batch;
mod filled;
mod foreign;
mod frame;
mod handover;
mod observed;
mod process;
mod stream;

pub(super) use foreign::ForeignSystem;
pub(super) use observed::ObservedAnswer;
