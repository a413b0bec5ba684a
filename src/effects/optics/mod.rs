//! In the optics: from the camera's ray to light on the pixels.
