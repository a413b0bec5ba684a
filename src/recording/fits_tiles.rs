//! Tile-compressed FITS images (`fpack`): the numbers of the table are checked here, before `fitsio-pure` unpacks the tiles.
//!
//! Source: FITS Standard 4.0 (2018), section 10. RICE_1, GZIP_1, GZIP_2, PLIO_1, HCOMPRESS_1 and NOCOMPRESS; floating point quantised or not.

use std::io::Read;

use fitsio_pure::header::Card;
use fitsio_pure::value::Value;
use flate2::read::{DeflateDecoder, MultiGzDecoder, ZlibDecoder};

use super::error::FrameProblem;
use super::fits::{fault, text_of, value};

/// Columns of the table, at most.
const MAX_COLUMNS: i64 = 64;
/// Axes of the image, at most.
const MAX_AXES: i64 = 8;
/// Pixels of one block of Rice coding, at most; programs write 16 or 32.
const MAX_RICE_BLOCK: i64 = 4096;

/// How an image is packed.
#[derive(Clone, Debug)]
pub(super) struct Tiling {
    pub(super) bitpix: i64,
    /// Lengths of the image's axes.
    pub(super) axes: Vec<u64>,
    tile: Vec<u64>,
    method: String,
    row_bytes: u64,
    rows: u64,
}

/// A column of arrays in the heap.
struct HeapColumn {
    offset: u64,
    wide: bool,
}

fn whole(cards: &[Card], keyword: &str, range: std::ops::RangeInclusive<i64>) -> Result<Option<i64>, FrameProblem> {
    match value(cards, keyword) {
        None => Ok(None),
        Some(Value::Integer(number)) if range.contains(number) => Ok(Some(*number)),
        Some(other) => Err(fault(keyword, format!("{} is not a whole number from {} to {}", text_of(other), range.start(), range.end()))),
    }
}

impl Tiling {
    /// From the header of a table with ZIMAGE.
    pub(super) fn read(cards: &[Card]) -> Result<Self, FrameProblem> {
        let needed = |keyword: &str, range| {
            whole(cards, keyword, range)?.ok_or_else(|| fault(keyword, "is missing, the file is damaged".to_owned()))
        };
        let bitpix = needed("ZBITPIX", -64..=64)?;
        if ![8, 16, 32, 64, -32, -64].contains(&bitpix) {
            return Err(fault("ZBITPIX", format!("{bitpix} is none of 8, 16, 32, 64, -32, -64")));
        }
        let count = needed("ZNAXIS", 1..=MAX_AXES)?;
        let length = |axis: i64| needed(&format!("ZNAXIS{axis}"), 0..=1 << 40).map(|length| length as u64);
        let axes: Vec<u64> = (1..=count).map(length).collect::<Result<_, _>>()?;
        let tile = (1..=count).zip(&axes).map(|(axis, &length)| {
            // a tile is a row where nobody says more
            let absent = if axis == 1 { length.cast_signed() } else { 1 };
            let tile = whole(cards, &format!("ZTILE{axis}"), 1..=i64::MAX)?.unwrap_or(absent);
            Ok((tile as u64).min(length.max(1)))
        });
        let tile: Vec<u64> = tile.collect::<Result<_, FrameProblem>>()?;
        let method = match value(cards, "ZCMPTYPE") {
            Some(Value::String(name)) => name.trim().to_owned(),
            _ => return Err(fault("ZCMPTYPE", "is missing, the file is damaged".to_owned())),
        };
        if !["RICE_1", "RICE_ONE", "GZIP_1", "GZIP_2", "PLIO_1", "HCOMPRESS_1", "NOCOMPRESS"].contains(&method.as_str()) {
            return Err(fault("ZCMPTYPE", format!("{method:?} is not known; unpack the file with funpack")));
        }
        if method.starts_with("RICE") {
            let (block, bytes) = (whole(cards, "ZVAL1", 1..=MAX_RICE_BLOCK)?, whole(cards, "ZVAL2", 1..=MAX_RICE_BLOCK)?);
            let is_width = |bytes: i64| [1, 2, 4].contains(&bytes);
            if !is_width(bytes.unwrap_or(4)) && !is_width(block.unwrap_or(32)) {
                return Err(fault("ZVAL2", format!("{} is none of 1, 2, 4 (bytes of a pixel)", bytes.unwrap_or(4))));
            }
        }
        whole(cards, "TFIELDS", 1..=MAX_COLUMNS)?;
        let (row_bytes, rows) = (needed("NAXIS1", 1..=1 << 20)? as u64, needed("NAXIS2", 0..=1 << 40)? as u64);
        Ok(Self { bitpix, axes, tile, method, row_bytes, rows })
    }

    /// Pixels of a tile; those at the far edges are smaller.
    fn tile_pixels(&self, mut index: u64) -> u64 {
        let extent = |(&length, &tile): (&u64, &u64)| {
            let count = length.div_ceil(tile).max(1);
            let at = index % count;
            index /= count;
            tile.min(length.saturating_sub(at * tile))
        };
        self.axes.iter().zip(&self.tile).map(extent).product()
    }

    /// Checks table and heap against the bytes that are there; `data`: from the table's first row on.
    pub(super) fn check(&self, cards: &[Card], data: &[u8]) -> Result<(), FrameProblem> {
        let tiles: u64 = self.axes.iter().zip(&self.tile).map(|(&length, &tile)| length.div_ceil(tile)).product();
        if tiles != self.rows {
            let problem = format!("{} rows cannot be the {tiles} tiles of the image, the file is damaged", self.rows);
            return Err(fault("NAXIS2", problem));
        }
        let columns = [("COMPRESSED_DATA", self.is_gzip()), ("GZIP_COMPRESSED_DATA", true)];
        let mut found = Vec::new();
        for (name, gzip) in columns {
            found.extend(self.column(cards, name)?.map(|column| (column, gzip)));
        }
        for row in 0..self.rows {
            for (column, gzip) in &found {
                let tile = self.tile_bytes(column, row, data)?;
                if *gzip && !tile.is_empty() {
                    self.check_gzip(row, tile)?;
                }
            }
        }
        Ok(())
    }

    fn is_gzip(&self) -> bool {
        self.method.starts_with("GZIP")
    }

    /// Where a column stands in the rows.
    fn column(&self, cards: &[Card], wanted: &str) -> Result<Option<HeapColumn>, FrameProblem> {
        let count = whole(cards, "TFIELDS", 1..=MAX_COLUMNS)?.unwrap_or(0);
        let text = |keyword: &str| match value(cards, keyword) {
            Some(Value::String(text)) => Some(text.trim().to_owned()),
            _ => None,
        };
        let mut offset = 0_u64;
        for index in 1..=count {
            let keyword = format!("TFORM{index}");
            let form = text(&keyword).ok_or_else(|| fault(&keyword, "is missing, the file is damaged".to_owned()))?;
            let digits = form.bytes().take_while(u8::is_ascii_digit).count();
            let repeat: u64 = if digits == 0 { 1 } else { form[..digits].parse().unwrap_or(u64::MAX) };
            let letter = form[digits..].chars().next().unwrap_or(' ');
            if text(&format!("TTYPE{index}")).as_deref() == Some(wanted) {
                let column = HeapColumn { offset, wide: letter == 'Q' };
                let length = if column.wide { 16 } else { 8 };
                if !matches!(letter, 'P' | 'Q') || offset + length > self.row_bytes {
                    return Err(fault(&keyword, format!("{form:?} is no column of packed tiles, the file is damaged")));
                }
                return Ok(Some(column));
            }
            let width = match letter {
                'X' => repeat.div_ceil(8),
                'L' | 'B' | 'A' => repeat,
                'I' => repeat.saturating_mul(2),
                'J' | 'E' => repeat.saturating_mul(4),
                'K' | 'D' | 'C' | 'P' => repeat.saturating_mul(8),
                'M' | 'Q' => repeat.saturating_mul(16),
                _ => return Err(fault(&keyword, format!("{form:?} is no form of a column, the file is damaged"))),
            };
            offset = offset.saturating_add(width).min(1 << 40);
        }
        Ok(None)
    }

    /// The bytes of a tile; a column of 16-bit words counts words, of which at least so many bytes are there.
    fn tile_bytes<'d>(&self, column: &HeapColumn, row: u64, data: &'d [u8]) -> Result<&'d [u8], FrameProblem> {
        let outside = || FrameProblem::Fits(format!("its tile {row} lies outside the file; the file is cut off or damaged, copy it again"));
        let at = (row * self.row_bytes + column.offset) as usize;
        let whole = |bytes: &[u8]| bytes.iter().fold(0_u64, |all, byte| all << 8 | u64::from(*byte));
        let half = if column.wide { 8 } else { 4 };
        let descriptor = data.get(at..at + 2 * half).ok_or_else(outside)?;
        let (count, from) = (whole(&descriptor[..half]), whole(&descriptor[half..]));
        if count >= 1 << 40 || from >= 1 << 40 {
            return Err(outside());
        }
        let start = self.row_bytes * self.rows + from;
        data.get(start as usize..(start + count) as usize).ok_or_else(outside)
    }

    /// Whether a gzipped tile unpacks to the tile's pixels, no more and no fewer.
    fn check_gzip(&self, row: u64, tile: &[u8]) -> Result<(), FrameProblem> {
        let pixels = self.tile_pixels(row);
        let found = unpacked_length(tile, 8 * pixels + 1);
        let own = pixels * self.bitpix.unsigned_abs() / 8;
        // whole numbers are widened to four bytes by some programs, and quantised ones have four or two
        let accepted = [Some(own), Some(4 * pixels), (self.bitpix < 0).then_some(2 * pixels)];
        match found {
            Some(length) if accepted.contains(&Some(length)) => Ok(()),
            Some(length) => Err(FrameProblem::Fits(format!(
                "its tile {row} unpacks to {length} bytes where {own} are expected; the file is damaged, copy it again"
            ))),
            None => Err(FrameProblem::Fits(format!("its tile {row} cannot be unpacked; the file is damaged, copy it again"))),
        }
    }
}

/// Bytes that gzip, zlib or bare deflate data unpack to, counted up to `most`.
fn unpacked_length(packed: &[u8], most: u64) -> Option<u64> {
    let count = |reader: &mut dyn Read| std::io::copy(&mut reader.take(most), &mut std::io::sink()).ok();
    if packed.starts_with(&[0x1f, 0x8b]) {
        return count(&mut MultiGzDecoder::new(packed));
    }
    count(&mut ZlibDecoder::new(packed)).or_else(|| count(&mut DeflateDecoder::new(packed)))
}
