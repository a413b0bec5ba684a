//! ControlPoints → Calibration.
