//! Everything that knows wgpu, and nothing else does; it knows no physics.
