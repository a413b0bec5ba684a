//! Lists in an order, equals as they stood. All lists share one sort of places, whatever the members are: the standard library's is compiled anew
//! for every kind of member and every way of comparing, six kilobytes each.

use std::cmp::Ordering;

/// The smallest number first.
pub fn ascending<T>(all: &mut [T], value: impl Fn(&T) -> f64) {
    let order = sorted(all.iter().map(value).collect());
    reorder(all, order);
}

/// The largest number first.
pub fn descending<T>(all: &mut [T], value: impl Fn(&T) -> f64) {
    // The sign turns the order of `total_cmp` round exactly, for zeros and what is no number, too.
    let order = sorted(all.iter().map(|one| -value(one)).collect());
    reorder(all, order);
}

/// In the order of a comparison.
pub fn sort_by<T>(all: &mut [T], compare: impl Fn(&T, &T) -> Ordering) {
    let order = places(all.len(), &|a, b| compare(&all[a], &all[b]));
    reorder(all, order);
}

/// The smallest key first.
pub fn sort_by_key<T, K: Ord>(all: &mut [T], key: impl Fn(&T) -> K) {
    sort_by(all, |a, b| key(a).cmp(&key(b)));
}

fn places(count: usize, compare: &dyn Fn(usize, usize) -> Ordering) -> Vec<usize> {
    let mut places: Vec<usize> = (0..count).collect();
    places.sort_by(|a, b| compare(*a, *b));
    places
}

/// For each place the place that its member comes from.
fn sorted(values: Vec<f64>) -> Vec<usize> {
    let mut keyed: Vec<(f64, usize)> = values.into_iter().zip(0..).collect();
    keyed.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    keyed.into_iter().map(|(_, from)| from).collect()
}

/// Along each cycle of places.
fn reorder<T>(all: &mut [T], mut from: Vec<usize>) {
    for start in 0..from.len() {
        let mut place = start;
        while from[place] != start {
            let source = std::mem::replace(&mut from[place], place);
            all.swap(place, source);
            place = source;
        }
        from[place] = place;
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn the_order_is_that_of_a_stable_sort(values in prop::collection::vec(prop_oneof![-3_i8..3, Just(i8::MIN)], 0..40)) {
            let value = |number: i8| match number {
                i8::MIN => f64::NAN,
                2 => -0.0,
                number => f64::from(number),
            };
            let all: Vec<(i8, usize)> = values.into_iter().zip(0..).collect();
            let (mut up, mut down) = (all.clone(), all.clone());
            ascending(&mut up, |one| value(one.0));
            descending(&mut down, |one| value(one.0));
            let (mut is_up, mut is_down) = (all.clone(), all);
            is_up.sort_by(|a, b| value(a.0).total_cmp(&value(b.0)));
            is_down.sort_by(|a, b| value(b.0).total_cmp(&value(a.0)));
            let (mut compared, mut keyed, mut is_keyed) = (is_down.clone(), is_down.clone(), is_down.clone());
            sort_by(&mut compared, |a, b| value(a.0).total_cmp(&value(b.0)).then(b.1.cmp(&a.1)));
            prop_assert!(compared.windows(2).all(|two| value(two[0].0).total_cmp(&value(two[1].0)).then(two[1].1.cmp(&two[0].1)).is_lt()));
            sort_by_key(&mut keyed, |one| one.0 / 2);
            is_keyed.sort_by_key(|one| one.0 / 2);
            prop_assert_eq!(keyed, is_keyed);
            prop_assert_eq!(up, is_up);
            prop_assert_eq!(down, is_down);
        }
    }
}
