//! `boresight schema`: the form of scene files, for editors and checkers.

use anyhow::Result;

use super::{Answer, output};

/// Prints the schema.
pub(crate) fn schema() -> Result<Answer> {
    output::print(&output::json_text(&boresight::scene::schema())?)?;
    Ok(Answer::Yes)
}
