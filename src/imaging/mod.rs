//! Runs the pixel effects on the GPU, or their twins on the CPU.
