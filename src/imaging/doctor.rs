//! What `boresight doctor` says: the result, as it stands in files.

use schemars::JsonSchema;
use serde::Serialize;

use super::TwinReport;
use crate::gpu::AdapterReport;
use crate::provenance::Provenance;

/// The name of the file format.
pub const DOCTOR_FORMAT: &str = "boresight-doctor/1";

/// What there is to render with, and whether it can be trusted.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct DoctorResult {
    /// [`DOCTOR_FORMAT`].
    pub format: &'static str,
    /// The adapters of this machine.
    pub adapters: Vec<ListedAdapter>,
    /// How GPU and CPU agree.
    pub twin_check: TwinCheck,
    /// The built-in stars, for people.
    pub catalog: String,
    /// Threads in use.
    pub threads: usize,
    /// How this came about.
    pub provenance: Provenance,
}

/// A GPU adapter.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct ListedAdapter {
    /// Its name.
    pub name: String,
    /// Its driver.
    pub driver: String,
    /// The interface that it is spoken to by.
    pub interface: String,
    /// Whether it is a program and no hardware.
    pub is_software: bool,
}

impl From<AdapterReport> for ListedAdapter {
    fn from(AdapterReport { name, driver, interface, is_software, .. }: AdapterReport) -> Self {
        Self { name, driver, interface, is_software }
    }
}

/// How GPU and CPU agree.
#[derive(Clone, Debug, Serialize, JsonSchema)]
#[serde(tag = "status", rename_all = "kebab-case")]
pub enum TwinCheck {
    /// As they should.
    Agree(TwinDifferences),
    /// They do not: the adapter is not to be trusted.
    Differ(TwinDifferences),
    /// They were not compared.
    NotRun {
        /// Why.
        reason: String,
    },
}

/// Differences between a frame made on the GPU and the same frame made on the CPU.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct TwinDifferences {
    /// The adapter that was compared with the CPU.
    pub adapter: String,
    /// Pixels of the frame.
    pub pixels: usize,
    /// Largest difference of expected electrons, in units of the tolerance; up to 1 is agreement.
    pub electrons_in_tolerances: f64,
    /// Pixels whose counts differ in the noisy frame.
    pub differing_pixels: usize,
    /// The largest of those differences.
    pub largest_difference_dn: u16,
}

impl From<TwinReport> for TwinDifferences {
    fn from(found: TwinReport) -> Self {
        let TwinReport { adapter, pixels, electrons_in_tolerances, differing_pixels, largest_difference_dn } = found;
        Self { adapter, pixels, electrons_in_tolerances, differing_pixels, largest_difference_dn }
    }
}
