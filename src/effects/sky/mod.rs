//! In the sky: between the star and the camera.
