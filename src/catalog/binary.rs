//! The packed form of a catalogue, as it stands in `catalogs/*.bin`.
//!
//! Little-endian; every quantity an integer count of the step in which the sources print it, so nothing is lost by packing.
//!
//! | bytes | what |
//! |---|---|
//! | 8 | `BSTARCAT` |
//! | 2 | version of this form, 1 |
//! | 8 | epoch, Julian year (f64) |
//! | 4, 4, 4 | number of stars, of proper motions, of doubtful stars |
//! | 2, n | length of the source's description, and it (UTF-8) |
//! | 20 a star, brightest first | HIP (3), right ascension in 1e-8° (5), declination + 90° in 1e-8° (5), V in 0.01 mag (2), B − V in 0.001 mag (2; −32768 unknown), parallax in 0.01 mas (3; 0 unknown) |
//! | 9 a proper motion | index of the star (3), east times cos δ and north in 0.01 mas/yr (3, 3) |
//! | 5 a doubtful star | HIP (3), disagreement between its solutions in mas (2) |
//! | 32 | SHA-256 of all before |

use std::f64::consts::SQRT_2;
use std::path::Path;

use sha2::{Digest, Sha256};

use super::{Catalog, CatalogError, Star};
use crate::coordinates::Direction;
use crate::units::{DEG_RAD, MAS_RAD};

const MAGIC: &[u8; 8] = b"BSTARCAT";
const VERSION: u16 = 1;
/// Positions are counted in 1e-8 degrees.
const POSITION_STEPS_PER_DEG: f64 = 1e8;
const MAGNITUDE_STEPS: f64 = 100.0;
const COLOUR_STEPS: f64 = 1000.0;
const COLOUR_UNKNOWN: i16 = i16::MIN;
/// Parallaxes and proper motions are counted in 0.01 mas (a year).
const STEPS_PER_MAS: f64 = 100.0;
const HASH_BYTES: usize = 32;

impl Catalog {
    /// Packs the catalogue; the form is described at the head of `src/catalog/binary.rs`.
    pub fn to_bytes(&self) -> Result<Vec<u8>, CatalogError> {
        let moving: Vec<(usize, &Star, [f64; 2])> = self
            .stars
            .iter()
            .enumerate()
            .filter_map(|(index, star)| star.proper_motion_rad_yr.map(|motion| (index, star, motion)))
            .collect();
        let mut bytes = Vec::new();
        bytes.extend(MAGIC);
        bytes.extend(VERSION.to_le_bytes());
        bytes.extend(self.epoch_yr.to_le_bytes());
        for count in [self.stars.len(), moving.len(), self.doubtful.len()] {
            bytes.extend((count as u32).to_le_bytes());
        }
        bytes.extend((self.source.len() as u16).to_le_bytes());
        bytes.extend(self.source.bytes());
        for star in &self.stars {
            let (ra_rad, dec_rad) = star.direction.radec_rad();
            let ra_steps = (ra_rad / DEG_RAD * POSITION_STEPS_PER_DEG).round() % (360.0 * POSITION_STEPS_PER_DEG);
            let dec_steps = (dec_rad / DEG_RAD * POSITION_STEPS_PER_DEG).round() + 90.0 * POSITION_STEPS_PER_DEG;
            let mut put = |quantity, value, width| put_signed(&mut bytes, star.hip, quantity, value, width);
            put("number", f64::from(star.hip), 3)?;
            put("right ascension", ra_steps, 5)?;
            put("declination", dec_steps, 5)?;
            put("magnitude", star.magnitude * MAGNITUDE_STEPS, 2)?;
            put("colour", star.colour.map_or(f64::from(COLOUR_UNKNOWN), |colour| colour * COLOUR_STEPS), 2)?;
            put("parallax", star.parallax_rad / MAS_RAD * STEPS_PER_MAS, 3)?;
        }
        for (index, star, motion) in moving {
            put_signed(&mut bytes, star.hip, "index", index as f64, 3)?;
            for component in motion {
                put_signed(&mut bytes, star.hip, "proper motion", component / MAS_RAD * STEPS_PER_MAS, 3)?;
            }
        }
        for &(hip, per_axis_rad) in &self.doubtful {
            put_signed(&mut bytes, hip, "number", f64::from(hip), 3)?;
            put_signed(&mut bytes, hip, "disagreement", per_axis_rad * SQRT_2 / MAS_RAD, 2)?;
        }
        let hash = Sha256::digest(&bytes);
        bytes.extend(hash);
        Ok(bytes)
    }

    /// Reads a packed catalogue (as `boresight` carries it) from a file.
    pub fn from_packed(path: &Path) -> Result<Self, CatalogError> {
        let bytes = std::fs::read(path).map_err(|reason| CatalogError::Read { path: path.to_owned(), reason })?;
        decode(&bytes, &path.display().to_string())
    }
}

/// Whether a file begins as a packed catalogue does.
pub(super) fn is_packed(path: &Path) -> Result<bool, CatalogError> {
    use std::io::Read;
    let unreadable = |reason| CatalogError::Read { path: path.to_owned(), reason };
    let mut first = Vec::new();
    std::fs::File::open(path).and_then(|file| file.take(MAGIC.len() as u64).read_to_end(&mut first)).map_err(unreadable)?;
    Ok(first == MAGIC)
}

/// Appends a rounded number as a signed integer of `width` bytes.
fn put_signed(bytes: &mut Vec<u8>, hip: u32, quantity: &'static str, value: f64, width: u32) -> Result<(), CatalogError> {
    let limit = (1_i64 << (8 * width - 1)) as f64;
    let value = value.round();
    if !(-limit..limit).contains(&value) {
        return Err(CatalogError::OutOfRange { hip, quantity });
    }
    bytes.extend(&(value as i64).to_le_bytes()[..width as usize]);
    Ok(())
}

/// Unpacks a catalogue; `name` is for messages.
pub(super) fn decode(bytes: &[u8], name: &str) -> Result<Catalog, CatalogError> {
    let damaged = |place| CatalogError::Damaged { name: name.to_owned(), place };
    let body = bytes.len().checked_sub(HASH_BYTES).map(|end| &bytes[..end]).ok_or_else(|| damaged("its end"))?;
    let mut hasher = Sha256::new_with_prefix(body);
    if hasher.clone().finalize()[..] != bytes[body.len()..] {
        return Err(damaged("its checksum"));
    }
    hasher.update(&bytes[body.len()..]);
    let sha256 = hex(&hasher.finalize());
    unpack(body, sha256).map_err(damaged)
}

/// Unpacks what the checksum has vouched for; an error names the place.
fn unpack(body: &[u8], sha256: String) -> Result<Catalog, &'static str> {
    let mut rest = Reader(body);
    if rest.take(MAGIC.len())? != MAGIC {
        return Err("its first bytes");
    }
    if rest.signed(2)? != i64::from(VERSION) {
        return Err("its version");
    }
    let epoch_yr = rest.take(8)?.try_into().map(f64::from_le_bytes).map_err(|_| "its epoch")?;
    let star_count = rest.signed(4)?;
    let motion_count = rest.signed(4)?;
    let doubtful_count = rest.signed(4)?;
    let source_bytes = rest.signed(2)?;
    let source = rest.take(usize::try_from(source_bytes).map_err(|_| "its source")?)?;
    let source = String::from_utf8(source.to_vec()).map_err(|_| "its source")?;
    let mut stars = Vec::new();
    for _ in 0..star_count {
        let hip = rest.number()?;
        let ra_deg = rest.signed(5)? as f64 / POSITION_STEPS_PER_DEG;
        let dec_deg = rest.signed(5)? as f64 / POSITION_STEPS_PER_DEG - 90.0;
        let magnitude = rest.signed(2)? as f64 / MAGNITUDE_STEPS;
        let colour = rest.signed(2)?;
        let parallax_rad = rest.signed(3)? as f64 / STEPS_PER_MAS * MAS_RAD;
        stars.push(Star {
            hip,
            direction: Direction::from_radec_rad(ra_deg * DEG_RAD, dec_deg * DEG_RAD),
            proper_motion_rad_yr: None,
            parallax_rad,
            magnitude,
            colour: (colour != i64::from(COLOUR_UNKNOWN)).then_some(colour as f64 / COLOUR_STEPS),
        });
    }
    for _ in 0..motion_count {
        let index = rest.number()? as usize;
        let east = rest.signed(3)? as f64 / STEPS_PER_MAS * MAS_RAD;
        let north = rest.signed(3)? as f64 / STEPS_PER_MAS * MAS_RAD;
        stars.get_mut(index).ok_or("its proper motions")?.proper_motion_rad_yr = Some([east, north]);
    }
    let mut doubtful = Vec::new();
    for _ in 0..doubtful_count {
        let hip = rest.number()?;
        doubtful.push((hip, rest.signed(2)? as f64 * MAS_RAD / SQRT_2));
    }
    if !rest.0.is_empty() {
        return Err("its end");
    }
    Ok(Catalog::new(stars, epoch_yr, source, sha256).with_hipparcos_numbers().with_doubtful(doubtful))
}

/// What is left to read.
struct Reader<'a>(&'a [u8]);

impl<'a> Reader<'a> {
    fn take(&mut self, count: usize) -> Result<&'a [u8], &'static str> {
        let (taken, rest) = self.0.split_at_checked(count).ok_or("its end")?;
        self.0 = rest;
        Ok(taken)
    }

    /// A signed integer of `width` bytes.
    fn signed(&mut self, width: usize) -> Result<i64, &'static str> {
        let taken = self.take(width)?;
        let mut filled = [0; 8];
        filled[..width].copy_from_slice(taken);
        let unused_bits = 64 - 8 * width;
        Ok(i64::from_le_bytes(filled) << unused_bits >> unused_bits)
    }

    /// A catalogue number or an index.
    fn number(&mut self) -> Result<u32, &'static str> {
        u32::try_from(self.signed(3)?).map_err(|_| "a number below zero")
    }
}

/// Bytes as hexadecimal digits.
pub(super) fn hex(bytes: &[u8]) -> String {
    let digit = |value: u8| char::from_digit(u32::from(value), 16).unwrap_or('?');
    bytes.iter().flat_map(|byte| [digit(byte >> 4), digit(byte & 15)]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn two_stars() -> Catalog {
        let star = Star {
            hip: 1,
            direction: Direction::from_radec_rad(1.0, -1.2),
            proper_motion_rad_yr: None,
            parallax_rad: 0.0,
            magnitude: 7.25,
            colour: None,
        };
        let bright = Star {
            hip: 90_000,
            direction: Direction::from_radec_rad(359.999_999_99 * DEG_RAD, 89.999_999_99 * DEG_RAD),
            proper_motion_rad_yr: Some([-3775.4 * MAS_RAD, 765.54 * MAS_RAD]),
            parallax_rad: 742.12 * MAS_RAD,
            magnitude: -1.44,
            colour: Some(-0.4),
        };
        Catalog::new(vec![star, bright], 1991.25, "two stars".into(), String::new()).with_doubtful(vec![(1, 12.0 * MAS_RAD / SQRT_2)])
    }

    #[test]
    fn what_is_packed_comes_back() {
        let before = two_stars();
        let after = decode(&before.to_bytes().unwrap(), "test").unwrap();
        assert_eq!((after.epoch_yr, after.source.as_str()), (1991.25, "two stars"));
        assert_eq!(after.stars[0].hip, 90_000, "brightest first");
        for (a, b) in before.stars.iter().zip(&after.stars) {
            assert_eq!((a.hip, a.magnitude, a.colour), (b.hip, b.magnitude, b.colour));
            assert!(a.direction.angle_rad(&b.direction) < 0.026 * MAS_RAD, "half a step of 0.036 mas, on the diagonal");
            assert!((a.parallax_rad - b.parallax_rad).abs() < 1e-6 * MAS_RAD);
            assert_eq!(a.proper_motion_rad_yr.is_some(), b.proper_motion_rad_yr.is_some());
            for (x, y) in a.proper_motion_rad_yr.iter().flatten().zip(b.proper_motion_rad_yr.iter().flatten()) {
                assert!((x - y).abs() < 1e-6 * MAS_RAD);
            }
        }
        assert_eq!(after.doubtful.len(), 1);
        assert!((after.doubtful[0].1 / before.doubtful[0].1 - 1.0).abs() < 1e-12);
    }

    #[test]
    fn every_damaged_byte_and_every_cut_is_found() {
        let bytes = two_stars().to_bytes().unwrap();
        for place in 0..bytes.len() {
            let mut damaged = bytes.clone();
            damaged[place] ^= 0x10;
            assert!(matches!(decode(&damaged, "test"), Err(CatalogError::Damaged { .. })), "byte {place}");
            assert!(matches!(decode(&bytes[..place], "test"), Err(CatalogError::Damaged { .. })), "cut at {place}");
        }
    }

    #[test]
    fn a_body_that_ends_early_is_found_even_with_a_right_checksum() {
        let bytes = two_stars().to_bytes().unwrap();
        let body = &bytes[..bytes.len() - HASH_BYTES];
        for end in 0..body.len() {
            assert!(unpack(&body[..end], String::new()).is_err(), "end {end}");
        }
    }

    #[test]
    fn a_star_that_does_not_fit_is_named() {
        let mut catalog = two_stars();
        catalog.stars[1].hip = 20_000_000;
        let message = catalog.to_bytes().unwrap_err().to_string();
        assert_eq!(message, "star 20000000 cannot be packed: its number is out of range; leave it out");
    }
}
