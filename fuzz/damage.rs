//! Damage done to good inputs, by a seed: what a broken disk, a broken program and an attacker do.

use super::zoo::{File, crc};

/// SplitMix64 (Steele, Lea & Flood 2014): the damage is a function of the seed alone.
pub(crate) struct Chance(u64);

impl Chance {
    pub(crate) fn new(seed: u64) -> Self {
        Self(seed)
    }

    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ z >> 30).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ z >> 27).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ z >> 31
    }

    /// Below `end`, which is above 0.
    pub(crate) fn below(&mut self, end: usize) -> usize {
        (self.next() % end.max(1) as u64) as usize
    }
}

/// What is written in the place of numbers.
const NUMBERS: [&str; 16] = [
    "0",
    "-1",
    "1e308",
    "-1e-308",
    "9223372036854775807",
    "-9223372036854775808",
    "18446744073709551616",
    "1e400",
    "nan",
    "inf",
    "4294967295",
    "65536",
    "0.5",
    "1e9",
    "-0.0",
    "\"x\"",
];

/// A good input with some damage.
pub(crate) fn damaged(seeds: &[File], chance: &mut Chance) -> File {
    let (name, mut bytes) = seeds[chance.below(seeds.len())].clone();
    for _ in 0..=chance.below(4) {
        harm(&mut bytes, seeds, chance);
    }
    if name.ends_with("png") && chance.below(4) > 0 {
        mend(&mut bytes);
    }
    (name, bytes)
}

fn harm(bytes: &mut Vec<u8>, seeds: &[File], chance: &mut Chance) {
    if bytes.is_empty() {
        bytes.push(0);
    }
    // the heads of files are where the traps are
    let reach = if chance.below(2) == 0 { bytes.len() } else { bytes.len().min(400) };
    let at = chance.below(reach);
    match chance.below(9) {
        0 => bytes[at] ^= 1 << chance.below(8),
        1 => bytes[at] = [0, 1, 0x7F, 0x80, 0xFF][chance.below(5)],
        2 => bytes.truncate(at),
        3 => {
            let end = (at + chance.below(64)).min(bytes.len());
            bytes.drain(at..end);
        }
        4 => {
            let end = (at + 1 + chance.below(200)).min(bytes.len());
            let copy = bytes[at..end].to_vec();
            for _ in 0..=chance.below(20) {
                let into = chance.below(bytes.len());
                bytes.splice(into..into, copy.iter().copied());
            }
        }
        5 => {
            let value = [0, u32::MAX, 1 << 31, 65_535, 1][chance.below(5)].to_be_bytes();
            for (byte, new) in bytes[at..].iter_mut().zip(value) {
                *byte = new;
            }
        }
        6 => {
            let other = &seeds[chance.below(seeds.len())].1;
            let from = chance.below(other.len().max(1));
            let end = (from + chance.below(500)).min(other.len());
            let piece = other.get(from..end).unwrap_or(&[]).to_vec();
            let until = (at + piece.len()).min(bytes.len());
            bytes.splice(at..until, piece);
        }
        _ => number(bytes, at, chance),
    }
}

/// Another number in the place of the next one that is written in digits.
fn number(bytes: &mut Vec<u8>, at: usize, chance: &mut Chance) {
    let Some(start) = bytes[at..].iter().position(u8::is_ascii_digit).map(|ahead| at + ahead) else { return };
    let length = bytes[start..].iter().take_while(|byte| byte.is_ascii_digit() || **byte == b'.').count();
    let new = NUMBERS[chance.below(NUMBERS.len())].as_bytes();
    // cards of FITS stand in columns: what is longer takes the blanks before it
    if bytes.starts_with(b"SIMPLE") {
        let from = (start + length).saturating_sub(new.len());
        bytes.splice(from..start + length, new.iter().copied());
    } else {
        bytes.splice(start..start + length, new.iter().copied());
    }
}

/// Puts the checksums of a PNG right, so that the damage reaches the decoder.
fn mend(bytes: &mut [u8]) {
    let mut at = 8;
    while let Some(head) = bytes.get(at..at + 4) {
        let length = head.iter().fold(0_usize, |all, byte| all << 8 | usize::from(*byte));
        let Some(sum) = at.checked_add(8).and_then(|start| start.checked_add(length)).filter(|sum| sum + 4 <= bytes.len()) else { return };
        let right = crc(&bytes[at + 4..sum]).to_be_bytes();
        bytes[sum..sum + 4].copy_from_slice(&right);
        at = sum + 4;
    }
}
