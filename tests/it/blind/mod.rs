//! The benchmark of concealed recordings.

mod diagnosed;
mod generator;
mod scorer;
