//! The figures of the constellations: lines between stars.

use std::sync::LazyLock;

/// A line of a constellation's figure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct ConstellationLine {
    /// The constellation's Latin name.
    pub name: &'static str,
    /// Hipparcos numbers of the two stars that it joins.
    pub hips: [u32; 2],
}

/// Parsed from `catalogs/constellations.csv`.
static LINES: LazyLock<Vec<ConstellationLine>> = LazyLock::new(|| {
    include_str!("../../catalogs/constellations.csv")
        .lines()
        .skip(1)
        .filter_map(|line| {
            let mut cells = line.split(',').skip(1);
            let name = cells.next()?;
            let mut hip = || cells.next()?.parse().ok();
            Some(ConstellationLine { name, hips: [hip()?, hip()?] })
        })
        .collect()
});

/// All lines, constellation by constellation.
#[must_use]
pub fn constellation_lines() -> &'static [ConstellationLine] {
    &LINES
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::catalog::Catalog;

    /// Every line joins two stars of the embedded catalogue, and known figures are there.
    #[test]
    fn lines_join_stars_that_there_are() {
        let catalog = Catalog::embedded();
        for line in constellation_lines() {
            assert!(line.hips.iter().all(|hip| catalog.by_hip(*hip).is_some()), "{line:?}");
            let [a, b] = line.hips.map(|hip| catalog.by_hip(hip).unwrap().direction);
            assert!(a.angle_rad(&b) < 0.8, "{line:?} is longer than any figure's line");
        }
        let mut names: Vec<&str> = constellation_lines().iter().map(|line| line.name).collect();
        names.dedup();
        // Pictures have no letters for others.
        assert!(names.iter().all(|name| name.chars().all(|c| c == ' ' || c.is_alphabetic())), "{names:?}");
        assert!(names.len() >= 85, "{} constellations", names.len());
        // Orion's belt: Alnitak, Alnilam, Mintaka.
        let joins = |a: u32, b: u32| constellation_lines().iter().any(|line| line.hips == [a, b] || line.hips == [b, a]);
        assert!(joins(26_727, 26_311) && joins(26_311, 25_930));
    }
}
