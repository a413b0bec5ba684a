//! The benchmark of concealed recordings.

mod diagnosed;
mod generator;
mod pixels;
mod scorer;
