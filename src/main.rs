//! The command `boresight`: reads the command line, calls the library, writes results.

mod cli;

fn main() -> std::process::ExitCode {
    keep_freed_memory();
    cli::main()
}

/// Has glibc keep what frames free for the next frames. It gives memory back to the system above twice the size of the largest block that it has
/// freed, and pages taken anew cost an eighth of the time of a labelled frame of a megapixel. 32 MiB is the largest that it counts (mallopt(3)).
fn keep_freed_memory() {
    const LARGEST: usize = (32 << 20) - (64 << 10);
    drop(std::hint::black_box(Vec::<u8>::with_capacity(LARGEST)));
}
