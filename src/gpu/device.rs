//! An open device: kernels, buffers, work and what comes back.

use std::sync::{Arc, Mutex, PoisonError, mpsc};

use super::adapter::found;
use super::kernel::{Buffer, Kernel};
use super::{AdapterReport, Binding, Dispatch, GpuError, Need};

/// An open device on an adapter.
#[derive(Debug)]
pub struct Gpu {
    device: wgpu::Device,
    queue: wgpu::Queue,
    report: AdapterReport,
    /// The first error that the driver reported outside the calls that check for one.
    failure: Arc<Mutex<Option<String>>>,
}

impl Gpu {
    /// Opens the best adapter of the kind needed.
    pub fn open(need: Need) -> Result<Self, GpuError> {
        let mut refused = GpuError::NoAdapter { hardware_only: need == Need::Hardware };
        for (report, adapter) in found() {
            if need == Need::Hardware && report.is_software {
                continue;
            }
            match Self::on(adapter, report.clone()) {
                Ok(gpu) => return Ok(gpu),
                Err(error) => refused = error,
            }
        }
        Err(refused)
    }

    fn on(adapter: &wgpu::Adapter, report: AdapterReport) -> Result<Self, GpuError> {
        let descriptor = wgpu::DeviceDescriptor { label: Some("boresight"), ..Default::default() };
        let (device, queue) = pollster::block_on(adapter.request_device(&descriptor))
            .map_err(|error| GpuError::NoDevice { adapter: report.to_string(), reason: error.to_string() })?;
        let failure = Arc::new(Mutex::new(None));
        let kept = Arc::clone(&failure);
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| {
            kept.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert_with(|| error.to_string());
        }));
        Ok(Self { device, queue, report, failure })
    }

    /// The adapter in words.
    #[must_use]
    pub fn adapter(&self) -> &AdapterReport {
        &self.report
    }

    fn failed(&self, action: &'static str, reason: &impl ToString) -> GpuError {
        GpuError::Failed { adapter: self.report.to_string(), action, reason: reason.to_string() }
    }

    /// Runs `work` and turns whatever the driver reports meanwhile into an error.
    fn checked<T>(&self, action: &'static str, work: impl FnOnce() -> T) -> Result<T, GpuError> {
        let scopes = [wgpu::ErrorFilter::Internal, wgpu::ErrorFilter::OutOfMemory, wgpu::ErrorFilter::Validation]
            .map(|filter| self.device.push_error_scope(filter));
        let done = work();
        // Scopes are closed in the reverse order of their opening; every one is closed before any is judged.
        let [internal, memory, validation] = scopes;
        let errors = [validation, memory, internal].map(|scope| pollster::block_on(scope.pop()));
        let stray = self.failure.lock().unwrap_or_else(PoisonError::into_inner).take();
        match errors.into_iter().flatten().map(|error| error.to_string()).next().or(stray) {
            Some(reason) => Err(self.failed(action, &reason)),
            None => Ok(done),
        }
    }

    /// Compiles the entry point of a WGSL program. Its resources are `@group(0) @binding(i)` for the i-th of `bindings`.
    pub fn kernel(&self, label: &'static str, wgsl: &str, entry: &str, bindings: &[Binding]) -> Result<Kernel, GpuError> {
        self.checked("compiling a shader", || {
            let module = self
                .device
                .create_shader_module(wgpu::ShaderModuleDescriptor { label: Some(label), source: wgpu::ShaderSource::Wgsl(wgsl.into()) });
            let entries: Vec<_> = (0..).zip(bindings).map(|(index, binding)| binding.layout(index)).collect();
            let layout = self.device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: Some(label), entries: &entries });
            let pipeline_layout = self.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
                label: Some(label),
                bind_group_layouts: &[Some(&layout)],
                immediate_size: 0,
            });
            let pipeline = self.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                label: Some(label),
                layout: Some(&pipeline_layout),
                module: &module,
                entry_point: Some(entry),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                cache: None,
            });
            Kernel { pipeline, layout }
        })
    }

    /// Makes sure that `buffer` holds at least `bytes`; what it held is lost if it grows. A buffer that is large enough is kept, since
    /// the first touch of fresh memory costs more than the work on it.
    pub fn reserve(&self, buffer: &mut Option<Buffer>, label: &'static str, bytes: u64) -> Result<(), GpuError> {
        // A binding must hold at least one element of the shader's array, even of an empty list.
        let bytes = bytes.next_multiple_of(16).max(256);
        if buffer.as_ref().is_some_and(|held| held.0.size() >= bytes) {
            return Ok(());
        }
        *buffer = None; // before the new one is made: both might not fit
        let usage = wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC | wgpu::BufferUsages::COPY_DST;
        *buffer = Some(self.buffer(label, bytes, usage)?);
        Ok(())
    }

    fn buffer(&self, label: &'static str, size: u64, usage: wgpu::BufferUsages) -> Result<Buffer, GpuError> {
        self.checked("allocating a buffer", || {
            Buffer(self.device.create_buffer(&wgpu::BufferDescriptor { label: Some(label), size, usage, mapped_at_creation: false }))
        })
    }

    /// A uniform buffer with these bytes.
    pub fn uniform(&self, label: &'static str, bytes: &[u8]) -> Result<Buffer, GpuError> {
        let mut padded = bytes.to_vec();
        padded.resize(bytes.len().next_multiple_of(16).max(16), 0);
        let buffer = self.buffer(label, padded.len() as u64, wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST)?;
        self.upload(&buffer, &padded)?;
        Ok(buffer)
    }

    /// Writes bytes to the start of a buffer; their number is a multiple of 4.
    pub fn upload(&self, buffer: &Buffer, bytes: &[u8]) -> Result<(), GpuError> {
        self.checked("writing to a buffer", || self.queue.write_buffer(&buffer.0, 0, bytes))
    }

    /// Writes zeros to the first bytes of a buffer; their number is a multiple of 4.
    pub fn clear(&self, buffer: &Buffer, bytes: u64) -> Result<(), GpuError> {
        self.checked("clearing a buffer", || {
            let mut encoder = self.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
            encoder.clear_buffer(&buffer.0, 0, Some(bytes));
            self.queue.submit([encoder.finish()]);
        })
    }

    /// Starts the dispatches, one after the other; each sees what those before it wrote.
    pub fn submit(&self, dispatches: &[Dispatch<'_>]) -> Result<(), GpuError> {
        self.checked("running a shader", || {
            let mut encoder = self.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
            for dispatch in dispatches {
                let entries: Vec<_> = (0..)
                    .zip(dispatch.buffers)
                    .map(|(binding, buffer)| wgpu::BindGroupEntry { binding, resource: buffer.0.as_entire_binding() })
                    .collect();
                let group = self.device.create_bind_group(&wgpu::BindGroupDescriptor {
                    label: None,
                    layout: &dispatch.kernel.layout,
                    entries: &entries,
                });
                let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
                pass.set_pipeline(&dispatch.kernel.pipeline);
                pass.set_bind_group(0, &group, &[]);
                pass.dispatch_workgroups(dispatch.workgroups[0], dispatch.workgroups[1], 1);
            }
            self.queue.submit([encoder.finish()]);
        })
    }

    /// Copies the first bytes of a buffer, a multiple of 4, to the CPU and hands them to `take`. `staging` is kept for the next time.
    pub fn download<T>(
        &self,
        buffer: &Buffer,
        bytes: u64,
        staging: &mut Option<Buffer>,
        take: impl FnOnce(&[u8]) -> T,
    ) -> Result<T, GpuError> {
        const ACTION: &str = "reading a result back";
        let usage = wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST;
        let staged = match staging.take() {
            Some(held) if held.0.size() >= bytes => held,
            _ => self.buffer("staging", bytes.max(16), usage)?,
        };
        let (sender, receiver) = mpsc::channel();
        let polled = self.checked(ACTION, || {
            let mut encoder = self.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
            encoder.copy_buffer_to_buffer(&buffer.0, 0, &staged.0, 0, bytes);
            self.queue.submit([encoder.finish()]);
            staged.0.map_async(wgpu::MapMode::Read, 0..bytes, move |mapped| {
                drop(sender.send(mapped)); // the receiver waits below
            });
            self.device.poll(wgpu::PollType::wait_indefinitely())
        })?;
        polled.map_err(|error| self.failed(ACTION, &error))?;
        receiver.recv().map_err(|error| self.failed(ACTION, &error))?.map_err(|error| self.failed(ACTION, &error))?;
        let view = staged.0.get_mapped_range(0..bytes).map_err(|error| self.failed(ACTION, &error))?;
        let taken = take(&view);
        drop(view);
        staged.0.unmap();
        *staging = Some(staged);
        Ok(taken)
    }
}
