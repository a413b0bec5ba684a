//! Decoders of other crates run behind a guard: a damaged file may meet an index or a sum that they did not check, and no input may end the
//! program in a backtrace. What would have been a panic becomes a value.
//!
//! This rests on `panic = "unwind"`, which is the default; `Cargo.toml` says so.

use std::cell::Cell;
use std::panic::{AssertUnwindSafe, catch_unwind, set_hook, take_hook};
use std::sync::Once;

thread_local! {
    /// How many guarded calls this thread is within.
    static WITHIN: Cell<usize> = const { Cell::new(0) };
}

/// A decoder panicked.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("its content is damaged in a way that the decoder was not written for; copy the file again, or save it anew with another program")]
pub struct Panicked;

/// Counts a guarded call for as long as it lasts, unwinding included.
struct Guard;

impl Guard {
    fn enter() -> Self {
        WITHIN.with(|within| within.set(within.get() + 1));
        Self
    }
}

impl Drop for Guard {
    fn drop(&mut self) {
        WITHIN.with(|within| within.set(within.get() - 1));
    }
}

/// Calls `decode`; a panic in it is caught and nothing is printed. Panics of other threads, and those outside, are reported as ever.
///
/// What `decode` was changing when it panicked is to be thrown away by the caller: it should own it.
pub fn guarded<T>(decode: impl FnOnce() -> T) -> Result<T, Panicked> {
    static HOOK: Once = Once::new();
    HOOK.call_once(|| {
        let report = take_hook();
        set_hook(Box::new(move |info| {
            if WITHIN.try_with(Cell::get).unwrap_or(0) == 0 {
                report(info);
            }
        }));
    });
    let _guard = Guard::enter();
    catch_unwind(AssertUnwindSafe(decode)).map_err(|_| Panicked)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    #[allow(clippy::panic, reason = "what is guarded against")]
    fn a_panic_becomes_a_value_and_the_guard_ends_with_the_call() {
        assert_eq!(guarded(|| 7), Ok(7));
        let nested = guarded(|| (guarded(|| panic!("inner")), WITHIN.with(Cell::get)));
        assert_eq!(nested, Ok((Err(Panicked), 1)), "the inner call is over, the outer goes on");
        assert_eq!(guarded(|| [0][std::hint::black_box(3)]), Err(Panicked));
        assert_eq!(WITHIN.with(Cell::get), 0);
        let threads: Vec<_> = (0..8).map(|k| std::thread::spawn(move || guarded(|| assert!(k % 2 == 0, "odd")))).collect();
        let caught = threads.into_iter().filter_map(|thread| thread.join().ok()).filter(Result::is_err).count();
        assert_eq!(caught, 4);
    }
}
