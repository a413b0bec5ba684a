//! A deeper catalogue from foreign tables, joined with the embedded Hipparcos stars.
//!
//! Foreign tables give places and a magnitude in a band of their own, but no motions. What Hipparcos has as well takes from it its number (and
//! so its name), its parallax and its proper motion; where Hipparcos knows none, the motion is the way between the two epochs. The
//! same stars say how V and B − V follow from the table's own magnitude and colour: polynomials, fitted here and robustly. Hipparcos stars
//! that the table lacks are added.

use std::path::{Path, PathBuf};

use nalgebra::{DMatrix, DVector};
use sha2::{Digest, Sha256};

use super::binary::hex;
use super::foreign::{ForeignStar, ForeignTable, read};
use super::{Catalog, CatalogError, Star};
use crate::coordinates::{Direction, Icrs};
use crate::statistics::mad_sigma;
use crate::statistics::order::sort_by;
use crate::units::ARCSEC_RAD;

/// Stars of a table that is not Hipparcos's have numbers from here on.
pub(super) const FIRST_FOREIGN_NUMBER: u32 = 1_000_000;
/// The same star in two files of a set is found at places that differ by less.
const SAME_RAD: f64 = 0.2 * ARCSEC_RAD;
/// A star whose motion is known is looked for within this distance of where it must be, and within more where it is not.
const NEAR_RAD: f64 = 2.0 * ARCSEC_RAD;
const FAR_RAD: f64 = 10.0 * ARCSEC_RAD;
/// And it has nearly the magnitude that it should have.
const SAME_MAG: f64 = 1.5;
/// Powers of the colour in V and B − V.
const ORDER: i32 = 3;

/// What an import found.
#[derive(Clone, Debug, PartialEq, serde::Serialize, schemars::JsonSchema)]
#[non_exhaustive]
pub struct ImportReport {
    /// What was read, for people.
    pub kind: String,
    /// Stars in the files, the same star in two of them counted once.
    pub stars_read: usize,
    /// Rows of the files without a magnitude, which are left out.
    pub without_magnitude: usize,
    /// Stars of the catalogue that was made.
    pub stars: usize,
    /// Of them, those that Hipparcos has too.
    pub in_hipparcos: usize,
    /// Of them, those whose proper motion is the way between the two epochs.
    pub motions_from_places: usize,
    /// Hipparcos stars that the files lack and that were added.
    pub added_from_hipparcos: usize,
    /// Robust scatter of V about what follows from the table's magnitude and colour.
    pub v_scatter_mag: f64,
    /// The same of B − V; `None` where the table has no colours.
    pub colour_scatter_mag: Option<f64>,
    /// The epoch of the places, Julian year.
    pub epoch_yr: f64,
}

/// Makes a catalogue of foreign tables (see [`Catalog::from_csv`] for CSV), down to the V magnitude `faintest`.
pub fn import_catalog(paths: &[PathBuf], faintest: f64) -> Result<(Catalog, ImportReport), CatalogError> {
    let mut hasher = Sha256::new();
    let mut joined: Option<ForeignTable> = None;
    for path in paths {
        let bytes = std::fs::read(path).map_err(|reason| CatalogError::Read { path: path.clone(), reason })?;
        hasher.update(&bytes);
        let table = match read(path, &bytes) {
            Some(table) => table?,
            None => of_csv(path)?,
        };
        match &mut joined {
            None => joined = Some(table),
            Some(first) if first.kind == table.kind && first.epoch_yr == table.epoch_yr => {
                first.stars.extend(table.stars);
                first.without_magnitude += table.without_magnitude;
            }
            Some(first) => {
                let problem = format!(
                    "is of another kind ({}) or epoch than the files before it ({}); import each kind alone",
                    table.kind, first.kind
                );
                return Err(CatalogError::Foreign { path: path.clone(), problem });
            }
        }
    }
    let path = || paths.first().cloned().unwrap_or_default();
    let mut table = joined.filter(|table| !table.stars.is_empty()).ok_or_else(|| CatalogError::Empty { path: path() })?;
    keep_once(&mut table.stars);
    Ok(join(&table, faintest, hex(&hasher.finalize())))
}

/// A CSV table as a foreign one: its V is taken as a band like another.
fn of_csv(path: &Path) -> Result<ForeignTable, CatalogError> {
    let catalog = Catalog::from_csv(path)?;
    let star = |star: &Star| {
        let Star { direction, magnitude, colour, proper_motion_rad_yr, .. } = *star;
        ForeignStar { direction, magnitude, colour, motion_rad_yr: proper_motion_rad_yr }
    };
    Ok(ForeignTable {
        stars: catalog.stars.iter().map(star).collect(),
        without_magnitude: 0,
        epoch_yr: catalog.epoch_yr,
        kind: "CSV table",
        band: "its own",
    })
}

/// Leaves of stars at the same place the first, in order of place.
fn keep_once(stars: &mut Vec<ForeignStar>) {
    sort_by(stars, |a, b| a.direction.xyz[2].total_cmp(&b.direction.xyz[2]).then(a.magnitude.total_cmp(&b.magnitude)));
    let mut kept: Vec<ForeignStar> = Vec::with_capacity(stars.len());
    for star in stars.iter() {
        let is_near = |other: &&ForeignStar| star.direction.xyz[2] - other.direction.xyz[2] < SAME_RAD;
        let is_same = |other: &ForeignStar| {
            let apart2: f64 = (0..3).map(|axis| (star.direction.xyz[axis] - other.direction.xyz[axis]).powi(2)).sum();
            apart2 < SAME_RAD * SAME_RAD
        };
        if !kept.iter().rev().take_while(is_near).any(is_same) {
            kept.push(*star);
        }
    }
    *stars = kept;
}

/// Where a star stands after so many years; proper motion only.
fn moved(star: &Star, years: f64) -> Direction<Icrs> {
    let Some([east, north]) = star.proper_motion_rad_yr else { return star.direction };
    let (ra, dec) = star.direction.radec_rad();
    let ((sin_ra, cos_ra), (sin_dec, cos_dec)) = (ra.sin_cos(), dec.sin_cos());
    let to_east = [-sin_ra, cos_ra, 0.0];
    let to_north = [-cos_ra * sin_dec, -sin_ra * sin_dec, cos_dec];
    Direction::along([0, 1, 2].map(|axis| star.direction.xyz[axis] + years * (east * to_east[axis] + north * to_north[axis])))
}

/// The motion that brings a star from one place to another, rad a year.
fn motion(from: &Direction<Icrs>, to: &Direction<Icrs>, years: f64) -> [f64; 2] {
    let (ra, dec) = from.radec_rad();
    let ((sin_ra, cos_ra), (sin_dec, cos_dec)) = (ra.sin_cos(), dec.sin_cos());
    let way = [0, 1, 2].map(|axis| to.xyz[axis] - from.xyz[axis]);
    let east = -sin_ra * way[0] + cos_ra * way[1];
    let north = -cos_ra * sin_dec * way[0] - sin_ra * sin_dec * way[1] + cos_dec * way[2];
    [east / years, north / years]
}

/// A polynomial of the colour, and the scatter about it.
struct Law {
    coefficients: Vec<f64>,
    /// The colours of the stars that it was fitted to; it holds the values at their ends beyond them.
    range: [f64; 2],
    scatter: f64,
}

impl Law {
    fn at(&self, colour: f64) -> f64 {
        let colour = colour.clamp(self.range[0], self.range[1]);
        self.coefficients.iter().rev().fold(0.0, |sum, coefficient| sum * colour + coefficient)
    }

    /// Fits pairs (colour, value), twice without what lies far out.
    fn fit(pairs: &[(f64, f64)], order: i32) -> Option<Self> {
        let powers: Vec<i32> = (0..=order).collect();
        let mut kept = pairs.to_vec();
        let mut law = None;
        for _ in 0..4 {
            if kept.len() < 10 * powers.len() {
                return law;
            }
            let matrix = DMatrix::from_fn(kept.len(), powers.len(), |row, power| kept[row].0.powi(powers[power]));
            let values = DVector::from_iterator(kept.len(), kept.iter().map(|(_, value)| *value));
            let coefficients = (matrix.transpose() * &matrix).lu().solve(&(matrix.transpose() * values))?;
            let colours = || kept.iter().map(|(colour, _)| *colour);
            let range = [colours().fold(f64::INFINITY, f64::min), colours().fold(f64::NEG_INFINITY, f64::max)];
            let mut fitted = Self { coefficients: coefficients.iter().copied().collect(), range, scatter: 0.0 };
            let rests: Vec<f64> = pairs.iter().map(|(colour, value)| value - fitted.at(*colour)).collect();
            fitted.scatter = mad_sigma(&rests)?.max(1e-6);
            kept = pairs.iter().zip(&rests).filter(|(_, rest)| rest.abs() < 4.0 * fitted.scatter).map(|(pair, _)| *pair).collect();
            law = Some(fitted);
        }
        law
    }
}

/// A Hipparcos star and its row in the table.
struct Pair {
    hipparcos: usize,
    row: usize,
}

/// Which stars of Hipparcos are which rows: the nearest of nearly the same brightness; where the motion is not known, the only one.
fn pairs(table: &ForeignTable, rows: &Catalog, hipparcos: &Catalog, years: f64, offset_mag: f64) -> Vec<Pair> {
    let mut taken = vec![false; table.stars.len()];
    let mut pairs = Vec::new();
    for (number, star) in hipparcos.stars.iter().enumerate() {
        let place = moved(star, years);
        let is_known = star.proper_motion_rad_yr.is_some();
        let radius_rad = if is_known { NEAR_RAD } else { FAR_RAD };
        let mut near: Vec<(f64, usize)> = rows
            .stars_within(&place, radius_rad, f64::INFINITY)
            .into_iter()
            .filter(|&row| (rows.stars[row].magnitude + offset_mag - star.magnitude).abs() < SAME_MAG)
            .map(|row| (rows.stars[row].direction.angle_rad(&place), rows.stars[row].hip as usize))
            .filter(|(_, row)| !taken[*row])
            .collect();
        sort_by(&mut near, |a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        if let Some(&(_, row)) = near.first().filter(|_| is_known || near.len() == 1) {
            taken[row] = true;
            pairs.push(Pair { hipparcos: number, row });
        }
    }
    pairs
}

fn join(table: &ForeignTable, faintest: f64, sha256: String) -> (Catalog, ImportReport) {
    let hipparcos = Catalog::embedded();
    let years = table.epoch_yr - hipparcos.epoch_yr;
    let plain = |(row, star): (usize, &ForeignStar)| Star {
        hip: row as u32,
        direction: star.direction,
        proper_motion_rad_yr: star.motion_rad_yr,
        parallax_rad: 0.0,
        magnitude: star.magnitude,
        colour: None,
    };
    let rows = Catalog::new(table.stars.iter().enumerate().map(plain).collect(), table.epoch_yr, String::new(), String::new());
    let pairs = pairs(table, &rows, hipparcos, years, 0.0);
    let of = |pair: &Pair| (&hipparcos.stars[pair.hipparcos], &table.stars[pair.row]);
    let common = || pairs.iter().map(of);
    let offsets = |(star, foreign): (&Star, &ForeignStar)| Some((foreign.colour?, star.magnitude - foreign.magnitude));
    let colours = |(star, foreign): (&Star, &ForeignStar)| Some((foreign.colour?, star.colour?));
    let v_law = Law::fit(&common().filter_map(offsets).collect::<Vec<_>>(), ORDER);
    let v_alone = Law::fit(&common().map(|(star, foreign)| (0.0, star.magnitude - foreign.magnitude)).collect::<Vec<_>>(), 0);
    let colour_law = Law::fit(&common().filter_map(colours).collect::<Vec<_>>(), ORDER);
    let mut stars: Vec<Star> = table.stars.iter().enumerate().map(plain).collect();
    for (row, star) in stars.iter_mut().enumerate() {
        let foreign = &table.stars[row];
        let law = foreign.colour.and_then(|colour| v_law.as_ref().map(|law| law.at(colour)));
        star.magnitude += law.or(v_alone.as_ref().map(|law| law.at(0.0))).unwrap_or(0.0);
        star.colour = foreign.colour.and_then(|colour| colour_law.as_ref().map(|law| law.at(colour)));
        star.hip = FIRST_FOREIGN_NUMBER + row as u32;
    }
    let (mut is_there, mut motions_from_places) = (vec![false; hipparcos.stars.len()], 0);
    for pair in &pairs {
        let (known, star) = (&hipparcos.stars[pair.hipparcos], &mut stars[pair.row]);
        is_there[pair.hipparcos] = true;
        (star.hip, star.parallax_rad, star.magnitude) = (known.hip, known.parallax_rad, known.magnitude);
        star.colour = known.colour.or(star.colour);
        star.proper_motion_rad_yr = star.proper_motion_rad_yr.or(known.proper_motion_rad_yr).or_else(|| {
            motions_from_places += usize::from(years != 0.0);
            (years != 0.0).then(|| motion(&known.direction, &star.direction, years))
        });
    }
    stars.retain(|star| star.magnitude <= faintest);
    let in_hipparcos = stars.iter().filter(|star| star.hip < FIRST_FOREIGN_NUMBER).count();
    let lacking = hipparcos.stars.iter().zip(&is_there).filter(|(star, is_there)| !**is_there && star.magnitude <= faintest);
    let added: Vec<Star> = lacking.map(|(star, _)| Star { direction: moved(star, years), ..*star }).collect();
    stars.extend(&added);
    let report = ImportReport {
        kind: table.kind.to_owned(),
        stars_read: table.stars.len(),
        without_magnitude: table.without_magnitude,
        stars: stars.len(),
        in_hipparcos,
        motions_from_places,
        added_from_hipparcos: added.len(),
        v_scatter_mag: v_law.or(v_alone).map_or(f64::NAN, |law| law.scatter),
        colour_scatter_mag: colour_law.map(|law| law.scatter),
        epoch_yr: table.epoch_yr,
    };
    let source = format!("{}, {} joined with Hipparcos, V <= {faintest}", table.kind, table.band);
    (Catalog::new(stars, table.epoch_yr, source, sha256).with_hipparcos_numbers(), report)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::units::MAS_RAD;

    /// The embedded stars with their motions taken away, moved to another epoch, in another band: what comes out is what went in.
    #[test]
    fn hipparcos_through_a_foreign_table_comes_back() {
        let hipparcos = Catalog::embedded();
        let years = 24.75;
        let band = |star: &Star| star.colour.map_or(0.2, |colour| 0.05 + 0.1 * colour - 0.2 * colour * colour);
        let some: Vec<&Star> = hipparcos.stars.iter().step_by(9).collect();
        let mut table = ForeignTable {
            stars: some
                .iter()
                .map(|star| ForeignStar {
                    direction: moved(star, years),
                    magnitude: star.magnitude + band(star),
                    colour: star.colour.map(|colour| 0.9 * colour + 0.1),
                    motion_rad_yr: None,
                })
                .collect(),
            without_magnitude: 0,
            epoch_yr: hipparcos.epoch_yr + years,
            kind: "test",
            band: "T",
        };
        // A star of its own, where no other is near.
        table.stars.push(ForeignStar {
            direction: Direction::from_radec_rad(1.0, 0.001),
            magnitude: 9.0,
            colour: Some(0.55),
            motion_rad_yr: None,
        });
        let twice = table.stars[3];
        table.stars.push(twice);
        keep_once(&mut table.stars);
        assert_eq!(table.stars.len(), some.len() + 1);
        let (catalog, report) = join(&table, 99.0, String::new());
        assert!(report.in_hipparcos + 40 > some.len(), "{report:?}");
        assert_eq!(report.stars, report.in_hipparcos + report.added_from_hipparcos + (table.stars.len() - report.in_hipparcos));
        assert!(report.v_scatter_mag < 1e-3 && report.colour_scatter_mag.unwrap() < 1e-3, "{report:?}");
        for star in some.iter().filter(|star| star.proper_motion_rad_yr.is_some()).take(500) {
            let found = catalog.by_hip(star.hip).unwrap();
            assert!(found.direction.angle_rad(&moved(star, years)) < 1e-9 && found.proper_motion_rad_yr == star.proper_motion_rad_yr);
        }
        let own = catalog.stars.iter().find(|star| star.hip >= FIRST_FOREIGN_NUMBER && (star.magnitude - 9.0).abs() < 0.5).unwrap();
        let colour = (0.55 - 0.1) / 0.9;
        assert!((own.magnitude - (9.0 - (0.05 + 0.1 * colour - 0.2 * colour * colour))).abs() < 0.01, "V {}", own.magnitude);
        assert!((own.colour.unwrap() - colour).abs() < 0.01 && own.proper_motion_rad_yr.is_none());
        assert!(catalog.label(own).starts_with("star "));
        // Down to a magnitude, packed and read again.
        let (bright, _) = join(&table, 5.0, String::new());
        assert!(bright.stars.iter().all(|star| star.magnitude <= 5.0) && bright.stars.len() > 1000);
        assert!(bright.to_bytes().is_ok());
    }

    /// Of a star whose motion is not known, the way between the epochs tells it.
    #[test]
    fn a_motion_follows_from_two_places() {
        let hipparcos = Catalog::embedded();
        let star = hipparcos.stars.iter().find(|star| star.proper_motion_rad_yr.is_none()).unwrap();
        let given = [40.0 * MAS_RAD, -25.0 * MAS_RAD];
        let moving = Star { proper_motion_rad_yr: Some(given), ..*star };
        let table = ForeignTable {
            stars: vec![ForeignStar { direction: moved(&moving, 24.75), magnitude: star.magnitude, colour: None, motion_rad_yr: None }],
            without_magnitude: 0,
            epoch_yr: 2016.0,
            kind: "test",
            band: "T",
        };
        let (catalog, report) = join(&table, 99.0, String::new());
        assert_eq!(report.motions_from_places, 1);
        let found = catalog.by_hip(star.hip).unwrap().proper_motion_rad_yr.unwrap();
        assert!((0..2).all(|axis| (found[axis] - given[axis]).abs() < 0.01 * MAS_RAD), "{found:?}");
    }
}
