//! The command `boresight`: reads the command line, calls the library, writes results.

mod cli;

fn main() -> std::process::ExitCode {
    cli::main()
}
