//! An answer with what was seen of the process.

use crate::suite::answers::TrackerAnswer;

/// An answer with what the harness itself saw.
#[derive(Clone, Debug, Default)]
pub(in crate::suite) struct ObservedAnswer {
    /// The answer.
    pub(in crate::suite) answer: TrackerAnswer,
    /// From handing over to the answer, s.
    pub(in crate::suite) latency_s: Option<f64>,
    /// Peak memory of the process.
    pub(in crate::suite) peak_mib: Option<f64>,
}
