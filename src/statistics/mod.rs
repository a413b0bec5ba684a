//! Noise model, robust location and scale, weights, tests: one place for all of them.
