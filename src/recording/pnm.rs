//! PGM and PPM images: numbers in text or bytes behind a short header.
//!
//! Source: Netpbm documentation, pgm(5) and ppm(5). P2 and P5 are grey, P3 and P6 colours; above 255 a sample has two bytes, high one first.

use super::error::{FrameProblem, FrameSize};
use super::image_file::check_size;

/// The head of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Head {
    pub(super) size: FrameSize,
    pub(super) channels: usize,
    /// The largest count.
    pub(super) top: u32,
    text: bool,
    start: usize,
}

fn fault(problem: String) -> FrameProblem {
    FrameProblem::Decode { kind: "PGM", message: problem }
}

/// The next number of the text, blanks and comments stepped over.
fn number(bytes: &[u8], at: &mut usize) -> Option<u32> {
    loop {
        match bytes.get(*at)? {
            b'#' => *at += bytes[*at..].iter().position(|byte| *byte == b'\n')?,
            byte if byte.is_ascii_whitespace() => *at += 1,
            _ => break,
        }
    }
    let digits = bytes[*at..].iter().take_while(|byte| byte.is_ascii_digit()).count();
    let text = std::str::from_utf8(&bytes[*at..*at + digits]).ok()?;
    *at += digits;
    text.parse().ok()
}

impl Head {
    /// Whether a file begins like one.
    pub(super) fn is_at(bytes: &[u8]) -> bool {
        matches!(bytes, [b'P', b'2' | b'3' | b'5' | b'6', blank, ..] if blank.is_ascii_whitespace() || *blank == b'#')
    }

    pub(super) fn parse(bytes: &[u8]) -> Result<Self, FrameProblem> {
        let kind = bytes.get(1).copied().unwrap_or(0);
        let mut at = 2;
        let mut next = |what: &str| number(bytes, &mut at).ok_or_else(|| fault(format!("its head tells no {what}; copy the file again")));
        let (width_px, height_px, top) = (next("width")? as usize, next("height")? as usize, next("largest count")?);
        if !(1..=65535).contains(&top) {
            return Err(fault(format!("its largest count is {top}; it must be from 1 to 65535")));
        }
        let size = FrameSize { width_px, height_px };
        check_size(size)?;
        let (text, channels) = (matches!(kind, b'2' | b'3'), if matches!(kind, b'3' | b'6') { 3 } else { 1 });
        Ok(Self { size, channels, top, text, start: at + 1 })
    }

    /// Samples of the whole image.
    fn samples(&self) -> usize {
        self.size.width_px * self.size.height_px * self.channels
    }

    /// Refuses a file that is too short to hold the samples; of text only the least that could do is known.
    pub(super) fn check_length(&self, found_bytes: u64) -> Result<(), FrameProblem> {
        let width = if self.text || self.top > 255 { 2 } else { 1 };
        // the last number of a text needs no blank behind it
        let expected_bytes = (self.start + self.samples() * width - usize::from(self.text)) as u64;
        if found_bytes < expected_bytes {
            return Err(FrameProblem::Truncated { kind: "PGM", expected_bytes, found_bytes });
        }
        Ok(())
    }

    /// The samples, channel after channel of each pixel.
    pub(super) fn samples_of(&self, bytes: &[u8]) -> Result<Vec<u16>, FrameProblem> {
        self.check_length(bytes.len() as u64)?;
        let (count, top) = (self.samples(), self.top);
        let samples: Vec<u16> = if self.text {
            let mut at = self.start;
            let read = |index: usize| {
                let sample = number(bytes, &mut at).and_then(|sample| u16::try_from(sample).ok());
                sample.ok_or_else(|| fault(format!("sample {index} of {count} is no number from 0 to {top}; copy the file again")))
            };
            (0..count).map(read).collect::<Result<_, _>>()?
        } else if top > 255 {
            bytes[self.start..].chunks_exact(2).take(count).map(|pair| u16::from_be_bytes([pair[0], pair[1]])).collect()
        } else {
            bytes[self.start..].iter().take(count).map(|byte| u16::from(*byte)).collect()
        };
        if let Some(index) = samples.iter().position(|sample| u32::from(*sample) > top) {
            return Err(fault(format!("sample {index} is {}, above the largest count {top} of its head", samples[index])));
        }
        Ok(samples)
    }
}
