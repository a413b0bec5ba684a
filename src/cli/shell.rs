//! `boresight completions` and `boresight man`: shell completions and manual pages, made from the command line definition.

use std::path::PathBuf;

use anyhow::{Context, Result};
use boresight::recording::{ResultFolder, write_file};
use clap::{Args, Command, CommandFactory};
use clap_complete::Shell;

use super::options::{folder, heading};
use super::{Answer, Arguments, output};

/// Arguments of `completions`.
#[derive(Debug, Args)]
pub(crate) struct CompletionsArgs {
    /// The shell
    #[arg(value_enum)]
    shell: Shell,
}

/// Arguments of `man`.
#[derive(Debug, Args)]
#[command(next_help_heading = heading::OUTPUT)]
pub(crate) struct ManArgs {
    /// Write a page for every verb into this folder, instead of that of the program to stdout
    #[arg(short, long, value_name = "DIR", value_parser = folder())]
    output: Option<PathBuf>,
    /// Replace the pages that an earlier run wrote there
    #[arg(long)]
    force: bool,
}

/// Prints the completions of a shell.
pub(crate) fn completions(args: &CompletionsArgs) -> Result<Answer> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut Arguments::command(), "boresight", &mut script);
    output::print(&String::from_utf8(script).context("the completions are no text")?)?;
    Ok(Answer::Yes)
}

/// Prints or writes the manual.
pub(crate) fn man(args: &ManArgs) -> Result<Answer> {
    let mut command = Arguments::command();
    command.build();
    let Some(directory) = &args.output else {
        output::print(&String::from_utf8(page(command)?).context("the manual is no text")?)?;
        return Ok(Answer::Yes);
    };
    let _folder = ResultFolder::open(directory, "man", args.force)?;
    let mut pages = Vec::new();
    collect(command, "", &mut pages);
    let count = pages.len();
    for (name, command) in pages {
        write_file(&directory.join(format!("{name}.1")), &page(command)?)?;
    }
    output::print(&format!("{count} pages are in {}\n", directory.display()))?;
    Ok(Answer::Yes)
}

/// The command and those below it, with the names of their pages.
fn collect(command: Command, above: &str, pages: &mut Vec<(String, Command)>) {
    let name = if above.is_empty() { command.get_name().to_owned() } else { format!("{above}-{}", command.get_name()) };
    for verb in command.get_subcommands().filter(|verb| verb.get_name() != "help") {
        collect(verb.clone(), &name, pages);
    }
    pages.push((name, command));
}

fn page(command: Command) -> Result<Vec<u8>> {
    let mut text = Vec::new();
    clap_mangen::Man::new(command).render(&mut text).context("writing a page of the manual")?;
    Ok(text)
}
