//! What a program on the GPU consists of.

/// A compiled entry point.
#[derive(Debug)]
pub struct Kernel {
    pub(super) pipeline: wgpu::ComputePipeline,
    pub(super) layout: wgpu::BindGroupLayout,
}

/// Memory on the device.
#[derive(Debug)]
pub struct Buffer(pub(super) wgpu::Buffer);

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

impl Binding {
    pub(super) fn layout(self, binding: u32) -> wgpu::BindGroupLayoutEntry {
        let ty = match self {
            Self::Uniform => wgpu::BufferBindingType::Uniform,
            Self::Read => wgpu::BufferBindingType::Storage { read_only: true },
            Self::ReadWrite => wgpu::BufferBindingType::Storage { read_only: false },
        };
        wgpu::BindGroupLayoutEntry {
            binding,
            visibility: wgpu::ShaderStages::COMPUTE,
            ty: wgpu::BindingType::Buffer { ty, has_dynamic_offset: false, min_binding_size: None },
            count: None,
        }
    }
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
