//! Which stars lie in a cone: bands of declination, cut into cells of right ascension of about the same size.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use super::Star;
use crate::coordinates::{Direction, Icrs};

/// Bands of declination; 5° high, so that a cell holds about 25 of the embedded stars.
const BANDS: usize = 36;
const BAND_HEIGHT_RAD: f64 = PI / BANDS as f64;
/// Added to the reach of a cone where cells are chosen, against rounding at their edges.
const MARGIN_RAD: f64 = 1e-9;

/// The stars of a catalogue sorted into cells.
#[derive(Clone, Debug)]
pub(super) struct SkyGrid {
    /// First cell of each band, and one past the last cell.
    first_cell: Vec<usize>,
    /// First entry of each cell in `stars`, and one past the last.
    first_star: Vec<usize>,
    /// Indices of stars, cell by cell, brightest first in each.
    stars: Vec<u32>,
}

impl SkyGrid {
    /// Sorts the stars of a catalogue (brightest first) into cells.
    pub(super) fn new(stars: &[Star]) -> Self {
        let mut first_cell = vec![0];
        for band in 0..BANDS {
            let middle_rad = (band as f64 + 0.5) * BAND_HEIGHT_RAD - FRAC_PI_2;
            let cells = (TAU * middle_rad.cos() / BAND_HEIGHT_RAD).ceil().max(1.0) as usize;
            first_cell.push(first_cell[band] + cells);
        }
        let mut grid = Self { first_cell, first_star: Vec::new(), stars: vec![0; stars.len()] };
        let cells: Vec<usize> = stars.iter().map(|star| grid.cell_of(&star.direction)).collect();
        let mut first_star = vec![0; grid.first_cell[BANDS] + 1];
        for &cell in &cells {
            first_star[cell + 1] += 1;
        }
        for cell in 1..first_star.len() {
            first_star[cell] += first_star[cell - 1];
        }
        let mut next = first_star.clone();
        for (index, &cell) in cells.iter().enumerate() {
            grid.stars[next[cell]] = index as u32;
            next[cell] += 1;
        }
        grid.first_star = first_star;
        grid
    }

    /// Indices of the stars of `bright` (the first part of the catalogue) within `radius_rad` of `centre`, brightest first.
    pub(super) fn within(&self, bright: &[Star], centre: &Direction<Icrs>, radius_rad: f64) -> Vec<usize> {
        if radius_rad.is_nan() || radius_rad < 0.0 {
            return Vec::new();
        }
        // squared chord: exact for small angles, where the cosine is not
        let reach = if radius_rad >= PI { f64::INFINITY } else { 4.0 * (0.5 * radius_rad).sin().powi(2) };
        let inside = |star: &Star| {
            let chord: [f64; 3] = std::array::from_fn(|axis| star.direction.xyz[axis] - centre.xyz[axis]);
            chord.iter().map(|c| c * c).sum::<f64>() <= reach
        };
        let mut found = Vec::new();
        let mut take_cells = |cells: std::ops::Range<usize>| {
            for cell in cells {
                let members = &self.stars[self.first_star[cell]..self.first_star[cell + 1]];
                let members = members.iter().map(|&index| index as usize).take_while(|&index| index < bright.len());
                found.extend(members.filter(|&index| inside(&bright[index])));
            }
        };
        let (ra_rad, dec_rad) = centre.radec_rad();
        let radius_rad = radius_rad + MARGIN_RAD;
        let half_width_rad = half_width_in_ra(dec_rad, radius_rad);
        for band in band_of(dec_rad - radius_rad)..=band_of(dec_rad + radius_rad) {
            let (first, last) = (self.first_cell[band], self.first_cell[band + 1]);
            let width_rad = TAU / (last - first) as f64;
            match half_width_rad {
                Some(half_rad) if 2.0 * half_rad + 2.0 * width_rad < TAU => {
                    let start = self.cell_in_band(band, ra_rad - half_rad);
                    let end = self.cell_in_band(band, ra_rad + half_rad);
                    if start <= end {
                        take_cells(start..end + 1);
                    } else {
                        take_cells(first..end + 1);
                        take_cells(start..last);
                    }
                }
                _ => take_cells(first..last),
            }
        }
        found.sort_unstable();
        found
    }

    fn cell_of(&self, direction: &Direction<Icrs>) -> usize {
        let (ra_rad, dec_rad) = direction.radec_rad();
        self.cell_in_band(band_of(dec_rad), ra_rad)
    }

    fn cell_in_band(&self, band: usize, ra_rad: f64) -> usize {
        let cells = self.first_cell[band + 1] - self.first_cell[band];
        let cell = (ra_rad.rem_euclid(TAU) / TAU * cells as f64) as usize;
        self.first_cell[band] + cell.min(cells - 1)
    }
}

/// Band of a declination; beyond a pole, the last one before it.
fn band_of(dec_rad: f64) -> usize {
    (((dec_rad + FRAC_PI_2) / BAND_HEIGHT_RAD).max(0.0) as usize).min(BANDS - 1)
}

/// How far a cone reaches in right ascension to either side; `None` when it holds a pole, and so all right ascensions.
fn half_width_in_ra(dec_rad: f64, radius_rad: f64) -> Option<f64> {
    if dec_rad.abs() + radius_rad >= FRAC_PI_2 {
        return None;
    }
    Some((radius_rad.sin() / dec_rad.cos()).min(1.0).asin() + MARGIN_RAD)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::catalog::Catalog;
    use crate::coordinates::Direction;
    use crate::units::{ARCSEC_RAD, DEG_RAD};

    fn by_hand(catalog: &Catalog, centre: &Direction<Icrs>, radius_rad: f64, max_magnitude: f64) -> Vec<usize> {
        let near = |star: &Star| star.magnitude <= max_magnitude && star.direction.angle_rad(centre) <= radius_rad;
        (0..catalog.stars.len()).filter(|&index| near(&catalog.stars[index])).collect()
    }

    proptest::proptest! {
        #[test]
        fn a_cone_holds_what_a_search_of_all_stars_finds(
            ra_deg in -10.0..370.0_f64, dec_deg in -90.0..=90.0_f64, radius_deg in 0.0..100.0_f64, max_magnitude in 2.0..8.0_f64,
        ) {
            let catalog = Catalog::embedded();
            let centre = Direction::from_radec_rad(ra_deg * DEG_RAD, dec_deg * DEG_RAD);
            for radius_rad in [radius_deg * DEG_RAD, 0.1 * radius_deg * DEG_RAD] {
                let found = catalog.stars_within(&centre, radius_rad, max_magnitude);
                proptest::prop_assert_eq!(found, by_hand(catalog, &centre, radius_rad, max_magnitude));
            }
        }
    }

    #[test]
    fn cones_at_the_poles_at_ra_0_and_round_the_whole_sky() {
        let catalog = Catalog::embedded();
        for dec_deg in [-90.0, -89.9, -85.0, -0.1, 0.0, 84.9, 85.1, 90.0] {
            for ra_deg in [0.0, 0.01, 359.99] {
                for radius_deg in [0.2, 5.0, 30.0, 90.0, 179.0] {
                    let centre = Direction::from_radec_rad(ra_deg * DEG_RAD, dec_deg * DEG_RAD);
                    let found = catalog.stars_within(&centre, radius_deg * DEG_RAD, 6.0);
                    assert_eq!(found, by_hand(catalog, &centre, radius_deg * DEG_RAD, 6.0), "{ra_deg} {dec_deg} {radius_deg}");
                }
            }
        }
        let anywhere = Direction::from_radec_rad(1.0, 1.0);
        assert_eq!(catalog.stars_within(&anywhere, 4.0, 99.0).len(), catalog.stars.len());
        assert!(catalog.stars_within(&anywhere, -0.1, 99.0).is_empty());
        assert!(catalog.stars_within(&anywhere, f64::NAN, 99.0).is_empty());
    }

    #[test]
    fn a_cone_as_small_as_a_star_finds_it() {
        let catalog = Catalog::embedded();
        for (index, star) in catalog.stars.iter().enumerate().step_by(97) {
            assert!(catalog.stars_within(&star.direction, 0.0, 99.0).contains(&index));
            assert!(catalog.stars_within(&star.direction, 1e-3 * ARCSEC_RAD, star.magnitude).contains(&index));
        }
    }
}
