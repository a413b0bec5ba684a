//! Lists by a number of each member, equals in the order that they had. All lists share one sort: of numbers and places, whatever the members are.

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
            prop_assert_eq!(up, is_up);
            prop_assert_eq!(down, is_down);
        }
    }
}
