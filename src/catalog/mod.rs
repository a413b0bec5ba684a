//! Star catalogues: the embedded Hipparcos stars, and others read from CSV.

use crate::coordinates::{Direction, Icrs};

/// A catalogue star.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Star {
    /// Hipparcos number; in an imported catalogue without one, the number of its row (from 1).
    pub hip: u32,
    /// Direction at the catalogue's epoch.
    pub direction: Direction<Icrs>,
    /// Proper motion east (times cos δ) and north, rad per Julian year; `None` where the catalogue does not know it.
    pub proper_motion_rad_yr: Option<[f64; 2]>,
    /// Parallax in radians; 0 where unknown.
    pub parallax_rad: f64,
    /// V magnitude.
    pub magnitude: f64,
    /// B − V; `None` where unknown.
    pub colour: Option<f64>,
}

/// A star catalogue, brightest star first.
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
}
