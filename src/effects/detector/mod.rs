//! In the detector: from light on a pixel to a count.
