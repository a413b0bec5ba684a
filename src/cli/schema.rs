//! `boresight schema`: the forms of results and of input files, for programs that read or write them, editors and checkers.

use anyhow::Result;
use boresight::formats::{FORMATS, file_format};
use boresight::report::table;
use clap::Args;

use super::{Answer, Usage, output};

/// Arguments of `schema`.
#[derive(Debug, Args)]
pub(crate) struct SchemaArgs {
    /// The verb whose result, or the file whose form, is asked for; without it, the names are listed
    #[arg(value_name = "NAME")]
    name: Option<String>,
    /// As every verb has it; a schema is JSON in any case. Without a name: the schema of scene files
    #[arg(long, help_heading = super::options::heading::OUTPUT)]
    json: bool,
}

/// Prints a schema, or the names.
pub(crate) fn schema(args: &SchemaArgs) -> Result<Answer> {
    // Before results had schemas, that of scenes was the only one and went without a name.
    let Some(name) = args.name.as_deref().or(args.json.then_some("scene")) else {
        let rows: Vec<[&str; 3]> = FORMATS.iter().map(|format| [format.name, format.format, format.what]).collect();
        output::print_page(&table(&["name", "format", "what"], &rows))?;
        return Ok(Answer::Yes);
    };
    let Some(format) = file_format(name) else {
        let nearest = FORMATS.iter().map(|format| format.name).min_by_key(|known| strsim::damerau_levenshtein(name, known));
        let nearest = nearest.unwrap_or_default();
        return Err(Usage(format!("there is no schema {name}; did you mean {nearest}? (`boresight schema` lists them all)")).into());
    };
    output::print(&output::json_text(&format.schema())?)?;
    Ok(Answer::Yes)
}
