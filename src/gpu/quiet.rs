//! What drivers say on stderr while they are loaded, without the words that mean nothing here.
//!
//! A layer of Mesa asks for a Wayland display as soon as an adapter is listed, and where there is no `XDG_RUNTIME_DIR` (a container, cron) the library of
//! Wayland says so on stderr, whatever the program was told to say. No option of Vulkan or wgpu leaves that out, and a process cannot set the variable for
//! itself once it has threads; so stderr is held back while drivers are loaded, and passed on without those lines.

/// A line with this word is left out.
#[cfg(unix)]
const NOISE: &str = "XDG_RUNTIME_DIR";

/// Does `work` without that noise.
#[cfg(unix)]
pub(super) fn quietly<T>(work: impl FnOnce() -> T) -> T {
    let is_set = std::env::var_os(NOISE).is_some_and(|folder| std::path::Path::new(&folder).is_dir());
    let held = if is_set { None } else { Held::new().ok() };
    let done = work();
    drop(held);
    done
}

/// Elsewhere nobody makes it.
#[cfg(not(unix))]
pub(super) fn quietly<T>(work: impl FnOnce() -> T) -> T {
    work()
}

/// Stderr, held back until this is dropped.
#[cfg(unix)]
struct Held {
    stderr: std::os::fd::OwnedFd,
    said: std::fs::File,
}

#[cfg(unix)]
impl Held {
    fn new() -> std::io::Result<Self> {
        use std::os::fd::AsFd;
        let held = Self { stderr: std::io::stderr().as_fd().try_clone_to_owned()?, said: tempfile::tempfile()? };
        rustix::stdio::dup2_stderr(&held.said)?;
        Ok(held)
    }
}

#[cfg(unix)]
impl Drop for Held {
    fn drop(&mut self) {
        use std::io::{Read, Seek, Write};
        let mut said = Vec::new();
        // What cannot be passed on has nobody who could be told.
        let _ = rustix::stdio::dup2_stderr(&self.stderr);
        let _ = self.said.rewind().and_then(|()| self.said.read_to_end(&mut said));
        let said = String::from_utf8_lossy(&said);
        let kept: String = said.split_inclusive('\n').filter(|line| !line.contains(NOISE)).collect();
        let _ = std::io::stderr().write_all(kept.as_bytes());
    }
}
