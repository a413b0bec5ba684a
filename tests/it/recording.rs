//! Recordings: every form, every fault with its sentence, and the way there and back.

mod faults;
mod forms;
mod fuzz;
mod made;
mod output;
mod readers;
mod real;
mod round_trip;
mod zoo;
