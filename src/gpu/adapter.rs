//! Which adapters there are.

use std::sync::OnceLock;

use super::AdapterReport;
use super::quiet::quietly;

impl AdapterReport {
    fn of(adapter: &wgpu::Adapter) -> Self {
        let info = adapter.get_info();
        let driver =
            [info.driver.trim(), info.driver_info.trim()].into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join(", ");
        let interface = match info.backend {
            wgpu::Backend::Vulkan => "Vulkan".to_owned(),
            other => format!("{other:?}"),
        };
        Self { name: info.name, driver, interface, is_software: info.device_type == wgpu::DeviceType::Cpu }
    }
}

/// Every adapter on this machine, hardware first.
#[must_use]
pub fn adapters() -> Vec<AdapterReport> {
    found().iter().map(|(report, _)| report.clone()).collect()
}

/// Every adapter that can compute, the best kind of device first; among equals in the driver's order.
///
/// Looked for once in a process: loading the drivers takes longer than a frame, and some of them talk each time.
pub(super) fn found() -> &'static [(AdapterReport, wgpu::Adapter)] {
    static FOUND: OnceLock<Vec<(AdapterReport, wgpu::Adapter)>> = OnceLock::new();
    FOUND.get_or_init(|| quietly(look))
}

fn look() -> Vec<(AdapterReport, wgpu::Adapter)> {
    let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
    descriptor.backends = wgpu::Backends::VULKAN;
    // No validation layers: debug builds would ask for them, and old ones print false alarms about every shader.
    descriptor.flags = wgpu::InstanceFlags::empty().with_env();
    let instance = wgpu::Instance::new(descriptor);
    let mut all: Vec<_> = pollster::block_on(instance.enumerate_adapters(wgpu::Backends::VULKAN))
        .into_iter()
        .filter(|adapter| adapter.get_downlevel_capabilities().flags.contains(wgpu::DownlevelFlags::COMPUTE_SHADERS))
        .map(|adapter| (AdapterReport::of(&adapter), adapter))
        .collect();
    all.sort_by_key(|(_, adapter)| match adapter.get_info().device_type {
        wgpu::DeviceType::DiscreteGpu => 0,
        wgpu::DeviceType::IntegratedGpu => 1,
        wgpu::DeviceType::VirtualGpu => 2,
        wgpu::DeviceType::Other => 3,
        wgpu::DeviceType::Cpu => 4,
    });
    all
}
