//! The benchmark of concealed recordings.

mod diagnosed;
mod generator;
mod held_out;
mod pixels;
mod scorer;
