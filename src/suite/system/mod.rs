//! The system under test: how frames reach it and answers come back.

mod batch;
mod filled;
mod frame;
mod handover;
mod process;
mod stream;

pub(super) use handover::Handover;

use super::answers::TrackerAnswer;
use super::error::SuiteError;
use super::frames::{FrameBatch, HandedFrame};
use super::suite_file::{SystemMode, SystemTable};

/// An answer with what the harness itself saw.
#[derive(Clone, Debug, Default)]
pub struct ObservedAnswer {
    /// The answer.
    pub answer: TrackerAnswer,
    /// From handing over to the answer, s.
    pub latency_s: Option<f64>,
    /// Peak memory of the process.
    pub peak_mib: Option<f64>,
}

/// A program under test, ready for frames.
pub(super) struct ForeignSystem<'s> {
    table: &'s SystemTable,
    stream: Option<stream::StreamSystem>,
}

impl<'s> ForeignSystem<'s> {
    pub(super) fn new(table: &'s SystemTable) -> Self {
        Self { table, stream: None }
    }

    /// Hands frames over; one answer for each, in order.
    pub(super) fn answers(&mut self, batch: &FrameBatch, frames: &[HandedFrame]) -> Result<Vec<ObservedAnswer>, SuiteError> {
        let handover = Handover::new(self.table, batch)?;
        match self.table.mode {
            SystemMode::Frame => frame::answers(self.table, &handover, frames),
            SystemMode::Batch => batch::answers(self.table, &handover, batch, frames),
            SystemMode::Stream => {
                if self.stream.is_none() {
                    self.stream = Some(stream::StreamSystem::new(self.table));
                }
                match &mut self.stream {
                    Some(stream) => stream.answers(&handover, frames),
                    None => Ok(Vec::new()),
                }
            }
        }
    }
}
