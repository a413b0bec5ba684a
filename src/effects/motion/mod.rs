//! In the motion of the camera.
