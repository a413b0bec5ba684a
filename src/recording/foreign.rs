//! Recognition of files that are no image of ours, by their first bytes: what they are, and what to do with them.

use super::error::FrameProblem;
use super::tiff::RAW_REMEDY;

const SAVE_ANEW: &str = "save it as PNG or TIFF";
const UNPACK: &str = "unpack it first";
const SINGLE_FRAMES: &str = "write its frames as single PNG, TIFF or FITS files";

/// Where, what stands there, what it is, and the remedy. Sources: the formats' own descriptions; the first that fits is taken.
const KNOWN: &[(usize, &[u8], &str, &str)] = &[
    (0, b"GIF8", "a GIF image", SAVE_ANEW),
    (8, b"WEBP", "a WebP image", SAVE_ANEW),
    (8, b"AVI ", "an AVI video", SINGLE_FRAMES),
    (0, b"LUCAM-RECORDER", "a SER video", SINGLE_FRAMES),
    (4, b"ftypcrx", "a camera's raw file (CR3)", RAW_REMEDY),
    (4, b"ftypheic", "a HEIC image", SAVE_ANEW),
    (4, b"ftypheix", "a HEIC image", SAVE_ANEW),
    (4, b"ftypmif1", "a HEIC image", SAVE_ANEW),
    (4, b"ftypavif", "an AVIF image", SAVE_ANEW),
    (4, b"ftyp", "an MP4 or QuickTime video", SINGLE_FRAMES),
    (0, b"\x1A\x45\xDF\xA3", "a Matroska video", SINGLE_FRAMES),
    (0, b"FUJIFILMCCD-RAW", "a camera's raw file (RAF)", RAW_REMEDY),
    (0, b"IIRO", "a camera's raw file (ORF)", RAW_REMEDY),
    (0, b"IIRS", "a camera's raw file (ORF)", RAW_REMEDY),
    (0, b"MMOR", "a camera's raw file (ORF)", RAW_REMEDY),
    (0, b"IIU\0", "a camera's raw file (RW2)", RAW_REMEDY),
    (0, b"FOVb", "a camera's raw file (X3F)", RAW_REMEDY),
    (6, b"HEAPCCDR", "a camera's raw file (CRW)", RAW_REMEDY),
    (0, b"\x93NUMPY", "a NumPy array", "write it with astropy.io.fits or tifffile"),
    (0, b"XISF0100", "an XISF image", "save it as FITS or 16-bit TIFF"),
    (0, b"\x89HDF\r\n\x1A\n", "an HDF5 file", "write its image as FITS or TIFF"),
    (0, b"#ASDF", "an ASDF file", "write its image as FITS"),
    (0, b"8BPS", "a Photoshop image", SAVE_ANEW),
    (0, b"\x76\x2F\x31\x01", "an OpenEXR image", "save it as floating-point TIFF"),
    (0, b"#?RADIANCE", "a Radiance HDR image", "save it as floating-point TIFF"),
    (0, b"\0\0\0\x0CjP  ", "a JPEG 2000 image", SAVE_ANEW),
    (0, b"\xFF\x4F\xFF\x51", "a JPEG 2000 image", SAVE_ANEW),
    (0, b"\0\0\0\x0CJXL ", "a JPEG XL image", SAVE_ANEW),
    (0, b"\xFF\x0A", "a JPEG XL image", SAVE_ANEW),
    (0, b"qoif", "a QOI image", SAVE_ANEW),
    (0, b"P1", "a bitmap of black and white (PBM)", "save it as PGM or PNG"),
    (0, b"P4", "a bitmap of black and white (PBM)", "save it as PGM or PNG"),
    (0, b"P7", "a PAM image", "save it as PGM or PNG"),
    (0, b"Pf", "a PFM image", "save it as floating-point TIFF"),
    (0, b"PF", "a PFM image", "save it as floating-point TIFF"),
    (0, b"PK\x03\x04", "a ZIP archive", UNPACK),
    (0, b"BZh", "a file packed with bzip2", UNPACK),
    (0, b"\xFD7zXZ\0", "a file packed with xz", UNPACK),
    (0, b"\x28\xB5\x2F\xFD", "a file packed with zstd", UNPACK),
    (0, b"7z\xBC\xAF\x27\x1C", "a 7z archive", UNPACK),
    (257, b"ustar", "a tar archive", UNPACK),
    (0, b"%PDF", "a PDF document", "give the image itself"),
    (0, b"PAR1", "a Parquet table", "a star list is a CSV file that a recording.toml names with stars = \"FILE\""),
];

/// What a file that is not read is held to be.
pub(super) fn recognised(head: &[u8]) -> FrameProblem {
    let is = |at: usize, mark: &[u8]| head.get(at..).is_some_and(|rest| rest.starts_with(mark));
    match KNOWN.iter().find(|(at, mark, ..)| is(*at, mark)) {
        Some(&(_, _, kind, remedy)) => FrameProblem::OtherKind { kind: kind.to_owned(), remedy },
        None => FrameProblem::NotAnImage,
    }
}
