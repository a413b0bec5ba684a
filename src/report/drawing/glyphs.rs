//! Tests that the built-in font has what the pictures write: a character that it lacks is drawn as a box.

use std::path::{Path, PathBuf};
use std::sync::LazyLock;

/// The characters that the font has, as ranges from a first to a last one.
static COVERED: LazyLock<Vec<(u32, u32)>> = LazyLock::new(|| covered(epaint_default_fonts::UBUNTU_LIGHT));

/// The ranges of characters of a TrueType font, by its table `cmap` (formats 4 and 12); ranges without a glyph of their own are left out.
///
/// Source: the OpenType specification, cmap. What cannot be read has no characters.
fn covered(font: &[u8]) -> Vec<(u32, u32)> {
    let u16_at = |at: usize| font.get(at..at + 2).map(|b| u32::from(u16::from_be_bytes([b[0], b[1]])));
    let u32_at = |at: usize| font.get(at..at + 4).map(|b| u32::from_be_bytes([b[0], b[1], b[2], b[3]]));
    let read = || -> Option<Vec<(u32, u32)>> {
        let tables = u16_at(4)? as usize;
        let cmap = (0..tables).map(|k| 12 + 16 * k).find(|at| font.get(*at..*at + 4) == Some(b"cmap".as_slice()))?;
        let cmap = u32_at(cmap + 8)? as usize;
        let mut ranges = Vec::new();
        for k in 0..u16_at(cmap + 2)? as usize {
            let table = cmap + u32_at(cmap + 4 + 8 * k + 4)? as usize;
            match u16_at(table)? {
                4 => {
                    let twice = u16_at(table + 6)? as usize;
                    for segment in (0..twice).step_by(2) {
                        let end = u16_at(table + 14 + segment)?;
                        let start = u16_at(table + 16 + twice + segment)?;
                        let delta = u16_at(table + 16 + 2 * twice + segment)?;
                        let offset_at = table + 16 + 3 * twice + segment;
                        let offset = u16_at(offset_at)? as usize;
                        for code in start..=end.min(0xfffe) {
                            let glyph = if offset == 0 {
                                (code + delta) & 0xffff
                            } else {
                                u16_at(offset_at + offset + 2 * (code - start) as usize)?
                            };
                            if glyph != 0 {
                                ranges.push((code, code));
                            }
                        }
                    }
                }
                12 => {
                    for group in 0..u32_at(table + 12)? as usize {
                        let at = table + 16 + 12 * group;
                        ranges.push((u32_at(at)?, u32_at(at + 4)?));
                    }
                }
                _ => {}
            }
        }
        ranges.sort_unstable();
        ranges.dedup();
        Some(ranges)
    };
    read().unwrap_or_default()
}

/// Whether the font has a glyph for a character.
fn has_glyph(character: char) -> bool {
    let code = character as u32;
    let after = COVERED.partition_point(|(first, _)| *first <= code);
    after > 0 && COVERED[after - 1].1 >= code
}

/// Every character that a picture of this program may be asked to draw: those of the strings in the code that draws, and of the names and
/// units of parameters.
#[test]
fn every_character_of_every_label_is_in_the_font() {
    assert!(has_glyph('k') && has_glyph('σ') && has_glyph('−') && !has_glyph('\u{207b}') && !has_glyph('\u{1f30c}'));
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut files: Vec<PathBuf> = std::fs::read_dir(root.join("report/drawing")).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.extend(["pictures.rs", "diagnose_files.rs", "diagnose_text.rs"].map(|name| root.join("cli").join(name)));
    files.push(root.join("diagnose/profile.rs"));
    let mut checked = 0;
    for file in files {
        let text = std::fs::read_to_string(&file).unwrap();
        let code = text.split("#[cfg(test)]").next().unwrap();
        for line in code.lines().filter(|line| !line.trim_start().starts_with("//")) {
            // Table text of the terminal is no label.
            for c in line.chars().filter(|c| !c.is_ascii() && !"─●◐".contains(*c)) {
                assert!(has_glyph(c), "{}: {c:?} (U+{:04X}) in {line}", file.display(), c as u32);
                checked += 1;
            }
        }
    }
    assert!(checked > 20, "{checked}");
    for effect in crate::effects::DISPLACEMENTS {
        for spec in effect.parameters() {
            let text = [effect.id(), spec.name, spec.unit].concat();
            assert!(text.chars().all(has_glyph), "{text}");
        }
    }
}
