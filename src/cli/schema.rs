//! `boresight schema`: the JSON Schema of scene files, for editors and checkers.

use anyhow::Result;
use clap::Args;

use super::{Answer, output};

/// Arguments of `schema`.
#[derive(Debug, Args)]
pub(crate) struct SchemaArgs {
    /// As every verb has it; the schema is JSON in any case
    #[arg(long, help_heading = super::options::heading::OUTPUT)]
    #[allow(dead_code, reason = "it asks for what is printed anyhow")]
    json: bool,
}

/// Prints the schema.
pub(crate) fn schema(_: &SchemaArgs) -> Result<Answer> {
    output::print(&output::json_text(&boresight::scene::schema())?)?;
    Ok(Answer::Yes)
}
