//! Progress reports of a diagnosis.

/// A step, in the order in which they are taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Step {
    /// The model that the recording is held against is fitted.
    Baseline,
    /// All questions are asked, and chance too.
    Omnibus,
    /// Effects enter and leave.
    Attribution,
    /// Everything is chosen and sized anew in turns that leave parts of the recording out, and held against these.
    Proof,
    /// Everything is solved with what was found.
    Solution,
    /// What is left.
    Remainder,
    /// What speaks against the names.
    Adequacy,
    /// Sizes, rivals, what would decide.
    Findings,
    /// Random halves of the frames.
    HalfNights,
}

impl Step {
    /// How many there are.
    pub const COUNT: usize = 9;

    /// Its place among them, from 1.
    #[must_use]
    pub fn number(self) -> usize {
        self as usize + 1
    }

    /// In words.
    #[must_use]
    pub fn words(self) -> &'static str {
        match self {
            Self::Baseline => "fitting the model that the recording is held against",
            Self::Omnibus => "asking whether anything is missing, and simulated recordings too",
            Self::Attribution => "looking for what is missing",
            Self::Proof => "choosing anew in turns, and asking what each left out",
            Self::Solution => "solving with what was found",
            Self::Remainder => "asking what is left",
            Self::Adequacy => "asking what speaks against the names, and simulating anew",
            Self::Findings => "sizes, rivals, limits",
            Self::HalfNights => "holding random halves of the frames against one another",
        }
    }
}
