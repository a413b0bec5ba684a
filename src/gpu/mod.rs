//! Everything that knows wgpu, and nothing else does; it knows no physics.
//!
//! An [`Adapter`](adapters) is chosen, a [`Gpu`] opened on it, and compute [`Kernel`]s made from WGSL run over buffers. Only what every WebGPU
//! implementation grants is asked for (`Limits::default()`, no optional feature), so Mesa's lavapipe runs the same programs as a graphics card.
//! An error of the driver or of a shader is an `Err`, never a panic. Without the feature `gpu` no device opens (`src/gpu/absent.rs`), and all who ask for
//! one stay as they are.

#[cfg(not(feature = "gpu"))]
mod absent;
#[cfg(feature = "gpu")]
mod adapter;
#[cfg(feature = "gpu")]
mod device;
#[cfg(feature = "gpu")]
mod kernel;
#[cfg(feature = "gpu")]
mod quiet;
mod words;

#[cfg(not(feature = "gpu"))]
pub use absent::{NoBuffer as Buffer, NoGpu as Gpu, NoKernel as Kernel, adapters};
#[cfg(feature = "gpu")]
pub use adapter::adapters;
#[cfg(feature = "gpu")]
pub use device::Gpu;
#[cfg(feature = "gpu")]
pub use kernel::{Buffer, Kernel};
pub use words::{AdapterReport, Binding, Dispatch, Need};

/// The most bytes one storage binding may hold with the limits that every implementation grants.
pub const BINDING_BYTES: u64 = 128 << 20;

/// The most workgroups along one axis of a dispatch.
pub const WORKGROUPS_PER_AXIS: u32 = 65_535;

/// The most iterations that the loops of one invocation may take together.
///
/// Mesa's llvmpipe leaves every loop, without a word, when an invocation has spent 65 535 iterations over all its loops
/// (`LP_MAX_TGSI_LOOP_ITERATIONS`). Work is split into several dispatches before that.
pub const LOOP_BUDGET: u32 = 60_000;

/// Where the pixels are computed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Backend {
    /// A hardware GPU if there is one, else the CPU.
    #[default]
    Auto,
    /// A GPU adapter, also one in software (lavapipe); an error where there is none.
    Gpu,
    /// The CPU, no driver needed.
    Cpu,
}

impl std::str::FromStr for Backend {
    type Err = GpuError;
    fn from_str(text: &str) -> Result<Self, GpuError> {
        match text {
            "auto" => Ok(Self::Auto),
            "gpu" => Ok(Self::Gpu),
            "cpu" => Ok(Self::Cpu),
            _ => Err(GpuError::UnknownBackend { given: text.to_owned() }),
        }
    }
}

impl std::fmt::Display for Backend {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Auto => "auto",
            Self::Gpu => "gpu",
            Self::Cpu => "cpu",
        })
    }
}

/// What can go wrong with a GPU.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum GpuError {
    /// No adapter of the kind asked for.
    #[error(
        "no Vulkan adapter{} was found: install a driver (on Debian or Ubuntu `apt-get install mesa-vulkan-drivers` gives one in software), \
         or use the CPU with --backend cpu",
        if *.hardware_only { " in hardware" } else { "" }
    )]
    NoAdapter {
        /// Adapters in software were not asked for.
        hardware_only: bool,
    },
    /// An adapter that gives no device.
    #[error("the adapter {adapter} gives no device ({reason}); use another driver, or the CPU with --backend cpu")]
    NoDevice {
        /// Which.
        adapter: String,
        /// What the driver said.
        reason: String,
    },
    /// The driver refused something.
    #[error("the GPU {adapter} failed while {action}: {reason}; try --backend cpu")]
    Failed {
        /// Which adapter.
        adapter: String,
        /// What was being done.
        action: &'static str,
        /// What the driver said.
        reason: String,
    },
    /// The program was compiled without wgpu.
    #[error(
        "this build has no GPU backend: it was compiled without the feature `gpu`; compile it with that feature, or use the CPU with --backend cpu"
    )]
    NotBuilt,
    /// A word that names no backend.
    #[error("{given:?} is no backend: use auto, gpu or cpu")]
    UnknownBackend {
        /// The word.
        given: String,
    },
}
