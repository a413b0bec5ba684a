//! A program under test in the mode of its suite.

use super::handover::Handover;
use super::observed::ObservedAnswer;
use super::{batch, frame, stream};
use crate::suite::error::SuiteError;
use crate::suite::frames::{FrameBatch, HandedFrame};
use crate::suite::suite_file::{SystemMode, SystemTable};

/// A program under test, ready for frames.
pub(in crate::suite) struct ForeignSystem<'s> {
    table: &'s SystemTable,
    stream: Option<stream::StreamSystem>,
}

impl<'s> ForeignSystem<'s> {
    pub(in crate::suite) fn new(table: &'s SystemTable) -> Self {
        Self { table, stream: None }
    }

    /// Hands frames over; one answer for each, in order.
    pub(in crate::suite) fn answers(&mut self, batch: &FrameBatch, frames: &[HandedFrame]) -> Result<Vec<ObservedAnswer>, SuiteError> {
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
