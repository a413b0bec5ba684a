//! In the place of wgpu where the feature `gpu` is off: there is no adapter, and no device can be opened, so what follows an open device cannot happen.

use std::convert::Infallible;

use super::{AdapterReport, Binding, Dispatch, GpuError, Need};

/// An open device, of which there is none.
#[derive(Debug)]
pub struct NoGpu(Infallible);

/// A compiled entry point, of which there is none.
#[derive(Debug)]
pub struct NoKernel(Infallible);

/// Memory on the device, of which there is none.
#[derive(Debug)]
pub struct NoBuffer(Infallible);

/// No adapter.
#[must_use]
pub fn adapters() -> Vec<AdapterReport> {
    Vec::new()
}

impl NoGpu {
    /// Says that this build has none.
    pub fn open(_: Need) -> Result<Self, GpuError> {
        Err(GpuError::NotBuilt)
    }

    /// Cannot be called.
    #[must_use]
    pub fn adapter(&self) -> &AdapterReport {
        match self.0 {}
    }

    /// Cannot be called.
    pub fn kernel(&self, _: &'static str, _: &str, _: &str, _: &[Binding]) -> Result<NoKernel, GpuError> {
        match self.0 {}
    }

    /// Cannot be called.
    pub fn reserve(&self, _: &mut Option<NoBuffer>, _: &'static str, _: u64) -> Result<(), GpuError> {
        match self.0 {}
    }

    /// Cannot be called.
    pub fn uniform(&self, _: &'static str, _: &[u8]) -> Result<NoBuffer, GpuError> {
        match self.0 {}
    }

    /// Cannot be called.
    pub fn upload(&self, _: &NoBuffer, _: &[u8]) -> Result<(), GpuError> {
        match self.0 {}
    }

    /// Cannot be called.
    pub fn clear(&self, _: &NoBuffer, _: u64) -> Result<(), GpuError> {
        match self.0 {}
    }

    /// Cannot be called.
    pub fn submit(&self, _: &[Dispatch<'_>]) -> Result<(), GpuError> {
        match self.0 {}
    }

    /// Cannot be called.
    pub fn download<T>(&self, _: &NoBuffer, _: u64, _: &mut Option<NoBuffer>, _: impl FnOnce(&[u8]) -> T) -> Result<T, GpuError> {
        match self.0 {}
    }
}
