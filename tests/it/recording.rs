//! Recordings: every form, every fault with its sentence, and the way there and back.

mod real;
