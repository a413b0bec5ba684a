//! The benchmark of concealed recordings.

mod generator;
mod scorer;
