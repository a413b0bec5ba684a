//! The same work on many things at once, with the results in their order.
//!
//! rayon's own iterators are compiled anew for every place that uses them, six kilobytes each. What these functions share is compiled once.
//! For work of a microsecond and more: each piece has a lock of its own.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

use rayon::prelude::*;

/// The results for the numbers below `count`.
pub fn map_numbers<R: Send>(count: usize, of: impl Fn(usize) -> R + Sync) -> Vec<R> {
    let results: Vec<Mutex<Option<R>>> = std::iter::repeat_with(Mutex::default).take(count).collect();
    for_each_number(count, &|number| {
        let result = of(number);
        *results[number].lock().unwrap_or_else(PoisonError::into_inner) = Some(result);
    });
    // Every number had its turn, or a panic has gone up already: nothing is left out.
    results.into_iter().filter_map(|result| result.into_inner().unwrap_or_else(PoisonError::into_inner)).collect()
}

/// The results for all items.
pub fn map<T: Sync, R: Send>(items: &[T], of: impl Fn(&T) -> R + Sync) -> Vec<R> {
    map_numbers(items.len(), |number| of(&items[number]))
}

/// The results for the numbers below `count`, or the error of the lowest number that has one. Numbers behind one that has failed may be left out.
pub fn try_map_numbers<R: Send, E: Send>(count: usize, of: impl Fn(usize) -> Result<R, E> + Sync) -> Result<Vec<R>, E> {
    let lowest = AtomicUsize::new(usize::MAX);
    let found = map_numbers(count, |number| {
        // Those before a number that failed are looked at always, so the error is the same at any number of threads.
        (number < lowest.load(Ordering::Relaxed)).then(|| of(number).inspect_err(|_| _ = lowest.fetch_min(number, Ordering::Relaxed)))
    });
    found.into_iter().flatten().collect()
}

/// The results for all items, or the error of the first that has one. Items behind one that has failed may be left out.
pub fn try_map<T: Sync, R: Send, E: Send>(items: &[T], of: impl Fn(&T) -> Result<R, E> + Sync) -> Result<Vec<R>, E> {
    try_map_numbers(items.len(), |number| of(&items[number]))
}

/// Work on each part of `values`, `length` long but for the last one, with the part's number. A length of zero makes no parts.
pub fn for_each_part<T: Send>(values: &mut [T], length: usize, work: impl Fn(usize, &mut [T]) + Sync) {
    if length == 0 {
        return;
    }
    let parts: Vec<Mutex<&mut [T]>> = values.chunks_mut(length).map(Mutex::new).collect();
    for_each_number(parts.len(), &|number| work(number, &mut parts[number].lock().unwrap_or_else(PoisonError::into_inner)));
}

fn for_each_number(count: usize, work: &(dyn Fn(usize) + Sync)) {
    (0..count).into_par_iter().for_each(work);
}

#[cfg(test)]
mod tests {
    use super::{for_each_part, map, map_numbers, try_map, try_map_numbers};

    #[test]
    fn results_come_in_the_order_of_their_items() {
        let numbers: Vec<usize> = (0..1000).collect();
        assert_eq!(map_numbers(1000, |number| number), numbers);
        assert_eq!(map(&numbers, |number| number * number), numbers.iter().map(|number| number * number).collect::<Vec<_>>());
        assert_eq!(map_numbers(0, |number| number), Vec::<usize>::new());
    }

    #[test]
    fn the_first_error_is_told() {
        let at = |number| if number % 100 == 37 { Err(number) } else { Ok(number) };
        assert_eq!(try_map_numbers(1000, at), Err(37));
        assert_eq!(try_map_numbers(37, at).map(|all| all.len()), Ok(37));
        assert_eq!(try_map(&[3, 437, 37], |number| at(*number)), Err(437));
    }

    #[test]
    fn every_value_is_in_one_part() {
        let mut values = vec![0; 10];
        for_each_part(&mut values, 4, |number, part| part.iter_mut().for_each(|value| *value += 10 * (number + 1) + part_length(number)));
        assert_eq!(values, [14, 14, 14, 14, 24, 24, 24, 24, 32, 32]);
        for_each_part(&mut values, 0, |_, _| unreachable!());
    }

    fn part_length(number: usize) -> usize {
        if number < 2 { 4 } else { 2 }
    }

    #[test]
    fn a_panic_goes_up() {
        let ended = std::panic::catch_unwind(|| map_numbers(100, |number| assert!(number != 50)));
        assert!(ended.is_err());
    }
}
