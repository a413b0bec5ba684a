//! Counter-based random numbers, the same on CPU and GPU.
