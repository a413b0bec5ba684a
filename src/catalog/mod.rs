//! Star catalogues: the embedded Hipparcos stars, and others read from CSV.
//!
//! Positions are ICRS directions at the catalogue's own epoch; moving them to the date of a frame is the business of the
//! effects. What the catalogue does say about time is how far a position may be off by then: [`Catalog::position_sigma_rad`].

mod binary;
mod constellations;
mod error;
mod foreign;
mod import;
mod join;
mod names;
mod position_error;
mod result;
mod sky_grid;

use std::sync::{LazyLock, OnceLock};

use crate::coordinates::{Direction, Icrs};
use sky_grid::SkyGrid;

pub use error::CatalogError;
pub use join::{ImportReport, import_catalog};
pub use names::star_name;
inner!(constellations::{ConstellationLine, constellation_lines});
inner!(result::{CatalogImportResult, IMPORT_FORMAT});
inner!(position_error::{KNOWN_PROPER_MOTION_SIGMA_RAD_YR, POSITION_SIGMA_RAD, expected_proper_motion_sigma_rad_yr});

/// A catalogue star.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Star {
    /// Hipparcos number; in an imported catalogue without one, the number of its row (from 1; from a million on where others have their own).
    pub hip: u32,
    /// Direction at the catalogue's epoch.
    pub direction: Direction<Icrs>,
    /// Proper motion east (times cos δ) and north, rad per Julian year; `None` where the catalogue does not know it.
    pub proper_motion_rad_yr: Option<[f64; 2]>,
    /// Parallax in radians; 0 where unknown, also where the measured value was negative (farther than could be measured).
    pub parallax_rad: f64,
    /// V magnitude.
    pub magnitude: f64,
    /// B − V; `None` where unknown.
    pub colour: Option<f64>,
}

/// A star catalogue, brightest star first.
///
/// The indices used by queries are made on first use from [`Catalog::stars`]; to change the stars, make a new catalogue.
#[derive(Clone, Debug)]
pub struct Catalog {
    /// The stars in order of magnitude (then of number).
    pub stars: Vec<Star>,
    /// Epoch of the directions, Julian year (TDB).
    pub epoch_yr: f64,
    /// Where it is from, for people.
    pub source: String,
    /// SHA-256 of the bytes that it was read from, for provenance.
    pub sha256: String,
    /// Whether [`Star::hip`] is a Hipparcos number and not that of a row.
    numbers_are_hipparcos: bool,
    /// Stars whose solution is in doubt, in order of number: number, and error per axis in rad (and in rad per year of the motion).
    doubtful: Vec<(u32, f64)>,
    /// (number, index into `stars`), in order of number.
    by_number: OnceLock<Vec<(u32, u32)>>,
    sky_grid: OnceLock<SkyGrid>,
}

impl Catalog {
    /// A catalogue of `stars` (in any order) whose numbers are those of rows.
    #[must_use]
    pub fn new(stars: Vec<Star>, epoch_yr: f64, source: String, sha256: String) -> Self {
        let mut stars = stars;
        stars.sort_by(|a, b| a.magnitude.total_cmp(&b.magnitude).then(a.hip.cmp(&b.hip)));
        Self {
            stars,
            epoch_yr,
            source,
            sha256,
            numbers_are_hipparcos: false,
            doubtful: Vec::new(),
            by_number: OnceLock::new(),
            sky_grid: OnceLock::new(),
        }
    }

    /// Says that the numbers of the stars are those of the Hipparcos catalogue, so that their names are known.
    #[must_use]
    pub fn with_hipparcos_numbers(mut self) -> Self {
        self.numbers_are_hipparcos = true;
        self
    }

    /// Marks stars whose solution is in doubt: number, and error per axis in rad
    /// of the position (and in rad per year of the motion).
    #[must_use]
    pub fn with_doubtful(mut self, mut doubtful: Vec<(u32, f64)>) -> Self {
        doubtful.sort_by_key(|&(number, _)| number);
        self.doubtful = doubtful;
        self
    }

    /// The catalogue in the program itself: Hipparcos to V ≈ 8, decoded on the first call.
    #[must_use]
    pub fn embedded() -> &'static Self {
        static EMBEDDED: LazyLock<Catalog> = LazyLock::new(|| {
            #[expect(clippy::expect_used, reason = "the bytes are part of the program; a test decodes them")]
            binary::decode(include_bytes!("../../catalogs/hipparcos.bin"), "catalogs/hipparcos.bin").expect("embedded catalogue")
        });
        &EMBEDDED
    }

    /// Reads a catalogue from a file: a packed one ([`Catalog::from_packed`]) or a CSV table ([`Catalog::from_csv`]), as its first bytes say.
    pub fn from_file(path: &std::path::Path) -> Result<Self, CatalogError> {
        if binary::is_packed(path)? { Self::from_packed(path) } else { Self::from_csv(path) }
    }

    /// Index into [`Catalog::stars`] of the star with this number.
    #[must_use]
    pub fn index_of(&self, hip: u32) -> Option<usize> {
        let by_number = self.by_number.get_or_init(|| {
            let mut pairs: Vec<(u32, u32)> = self.stars.iter().enumerate().map(|(index, star)| (star.hip, index as u32)).collect();
            pairs.sort_unstable();
            pairs
        });
        let place = by_number.binary_search_by_key(&hip, |&(number, _)| number).ok()?;
        Some(by_number[place].1 as usize)
    }

    /// The star with this number.
    ///
    /// ```
    /// let catalog = boresight::catalog::Catalog::embedded();
    /// let sirius = catalog.by_hip(32349).unwrap();
    /// assert_eq!(catalog.name(sirius), Some("Sirius"));
    /// assert!(sirius.magnitude < -1.4);
    /// ```
    #[must_use]
    pub fn by_hip(&self, hip: u32) -> Option<&Star> {
        self.index_of(hip).map(|index| &self.stars[index])
    }

    /// The proper name of a star of this catalogue; `None` without one, and where its number is not a Hipparcos number.
    #[must_use]
    pub fn name(&self, star: &Star) -> Option<&'static str> {
        if self.numbers_are_hipparcos { star_name(star.hip) } else { None }
    }

    /// What to write beside a star: its name, else its number ("HIP 1067", or "star 12" in a catalogue without such numbers).
    #[must_use]
    pub fn label(&self, star: &Star) -> String {
        match self.name(star) {
            Some(name) => name.to_owned(),
            None if self.numbers_are_hipparcos && star.hip < join::FIRST_FOREIGN_NUMBER => format!("HIP {}", star.hip),
            None => format!("star {}", star.hip),
        }
    }

    /// The stars not fainter than `max_magnitude`: the first part of [`Catalog::stars`].
    ///
    /// ```
    /// let bright = boresight::catalog::Catalog::embedded().brighter_than(1.0);
    /// assert!(bright.len() < 20 && bright.windows(2).all(|pair| pair[0].magnitude <= pair[1].magnitude));
    /// ```
    #[must_use]
    pub fn brighter_than(&self, max_magnitude: f64) -> &[Star] {
        &self.stars[..self.stars.partition_point(|star| star.magnitude <= max_magnitude)]
    }

    /// Indices of the stars within `radius_rad` of `centre` and not fainter than `max_magnitude`, brightest first.
    ///
    /// Positions are those at the catalogue's epoch: add to the radius what motion and aberration may have moved.
    #[must_use]
    pub fn stars_within(&self, centre: &Direction<Icrs>, radius_rad: f64, max_magnitude: f64) -> Vec<usize> {
        let bright = self.brighter_than(max_magnitude);
        self.sky_grid.get_or_init(|| SkyGrid::new(&self.stars)).within(bright, centre, radius_rad)
    }
}
