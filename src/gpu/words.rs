//! What is asked of a GPU, and in what words a result says on which it was made: nothing here needs wgpu.

use std::fmt;

use super::{Buffer, Gpu, Kernel, WORKGROUPS_PER_AXIS};

/// An adapter in words.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AdapterReport {
    /// Its name, such as `llvmpipe (LLVM 15.0.6, 256 bits)`.
    pub name: String,
    /// Driver and its version, such as `llvmpipe, Mesa 22.3.6 (LLVM 15.0.6)`.
    pub driver: String,
    /// The interface: `Vulkan`.
    pub interface: String,
    /// Whether it computes on the CPU.
    pub is_software: bool,
}

impl fmt::Display for AdapterReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let parts = [&self.name, &self.driver, &self.interface];
        let words: Vec<&str> = parts.into_iter().map(String::as_str).filter(|part| !part.is_empty()).collect();
        f.write_str(&words.join(" / "))
    }
}

/// What kind of adapter will do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Need {
    /// Any, also one in software.
    Any,
    /// Hardware only.
    Hardware,
}

/// How a kernel uses a buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Binding {
    /// `var<uniform>`
    Uniform,
    /// `var<storage, read>`
    Read,
    /// `var<storage, read_write>`
    ReadWrite,
}

/// One run of a kernel.
#[derive(Debug)]
pub struct Dispatch<'a> {
    /// What runs.
    pub kernel: &'a Kernel,
    /// Its buffers, in the order of its bindings.
    pub buffers: &'a [&'a Buffer],
    /// Workgroups along x and y.
    pub workgroups: [u32; 2],
}

impl Gpu {
    /// Workgroups along two axes that are together at least `count`, a row at a time.
    #[must_use]
    pub fn workgroups_for(count: u64) -> [u32; 2] {
        let rows = count.div_ceil(u64::from(WORKGROUPS_PER_AXIS)).max(1);
        [count.div_ceil(rows) as u32, rows as u32]
    }
}
