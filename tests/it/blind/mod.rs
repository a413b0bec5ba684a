//! The benchmark of concealed recordings.

mod diagnosed;
mod generator;
mod held_out;
mod images;
mod pixels;
mod scorer;
