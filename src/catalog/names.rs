//! Proper names of stars.

use std::sync::LazyLock;

/// Names by Hipparcos number, in order of number; parsed from `catalogs/names.csv`.
static NAMES: LazyLock<Vec<(u32, &'static str)>> = LazyLock::new(|| {
    include_str!("../../catalogs/names.csv")
        .lines()
        .skip(1)
        .filter_map(|line| line.split_once(','))
        .filter_map(|(hip, name)| Some((hip.parse().ok()?, name)))
        .collect()
});

/// The proper name of the star with this Hipparcos number (approved by the IAU where it approved one).
#[must_use]
pub fn star_name(hip: u32) -> Option<&'static str> {
    let place = NAMES.binary_search_by_key(&hip, |&(number, _)| number).ok()?;
    Some(NAMES[place].1)
}
