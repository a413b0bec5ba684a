//! World coordinates in FITS headers: one header for each frame, TAN with the distortion as SIP or TPV polynomials.
//!
//! ```text
//! u = column + 1 − CRPIX1, v = row + 1 − CRPIX2
//! SIP: (ξ, η) = CD·(u + A(u, v), v + B(u, v));   TPV: (ξ, η) = P(CD·(u, v))        degrees on the plane that touches the sphere at CRVAL
//! ```
//! CRPIX is the pixel on which light along the boresight falls (the principal point of the reference model) and CRVAL its direction, so both ways of
//! writing it take the distortion away at the measured point, as this program does: polynomials hold the reference model without loss.
//! What the directions are stands in WCSNAME ([`Meaning`]): places of the catalogue, for which RADESYS says ICRS in its full sense, or those of the
//! light as it arrives, for which it names the axes alone (FITS has no word for them).
//! Source: Greisen & Calabretta 2002, A&A 395, 1061; Calabretta & Greisen 2002, A&A 395, 1077; Shupe et al. 2005, ASP Conf. 347, 491;
//! the FITS registry's TPV convention.

use nalgebra::{Matrix2, Rotation3, Vector3};

use super::ExchangeError;
use crate::coordinates::Attitude;

/// Bytes of a card and of a block.
const CARD: usize = 80;
const BLOCK: usize = 2880;
/// Letters that a card has for a comment.
const COMMENT: usize = CARD - 8;
/// Powers of SIP polynomials that are read.
const SIP_MAXIMUM: usize = 9;
/// Coefficients of a TPV polynomial.
pub(super) const TPV_COUNT: usize = 40;

/// (i, j, coefficient) of uⁱ·vʲ, for both axes.
pub(super) type Polynomials = [Vec<(i32, i32, f64)>; 2];

/// What lies between the pixels and the tangential plane.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Distortion {
    /// Nothing.
    None,
    /// A and B.
    Sip(Polynomials),
    /// PV1_0 … PV1_39 and PV2_0 … PV2_39.
    Tpv(Box<[[f64; TPV_COUNT]; 2]>),
}

/// What the directions of a header are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Meaning {
    /// Places of the catalogue.
    Catalog,
    /// The light as it arrives.
    Apparent,
}

impl Meaning {
    /// WCSNAME.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Catalog => "ICRS PLACES",
            Self::Apparent => "APPARENT DIRECTIONS",
        }
    }
}

/// A frame's world coordinates.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Wcs {
    /// From 1.
    pub(super) crpix: [f64; 2],
    /// Right ascension and declination.
    pub(super) crval_rad: [f64; 2],
    /// Rad per pixel here, degrees in the file.
    pub(super) cd_rad: Matrix2<f64>,
    /// The distortion.
    pub(super) distortion: Distortion,
    /// Columns and rows, if the header says.
    pub(super) size_px: Option<[usize; 2]>,
}

/// East, north and outward at a direction.
fn axes(crval_rad: [f64; 2]) -> [Vector3<f64>; 3] {
    let ((sin_ra, cos_ra), (sin_dec, cos_dec)) = (crval_rad[0].sin_cos(), crval_rad[1].sin_cos());
    [
        Vector3::new(-sin_ra, cos_ra, 0.0),
        Vector3::new(-cos_ra * sin_dec, -sin_ra * sin_dec, cos_dec),
        Vector3::new(cos_ra * cos_dec, sin_ra * cos_dec, sin_dec),
    ]
}

/// CRVAL, and the matrix that takes (x/z, y/z) in camera axes to (ξ, η) in rad; `parity` −1 turns x first.
pub(super) fn plane(attitude: &Attitude, parity: i8) -> ([f64; 2], Matrix2<f64>) {
    let [right, down, out] = attitude.rows().map(Vector3::from);
    let crval = [out.y.atan2(out.x).rem_euclid(std::f64::consts::TAU), out.z.atan2(out.x.hypot(out.y))];
    let [east, north, _] = axes(crval);
    let right = right * f64::from(parity);
    (crval, Matrix2::new(right.dot(&east), down.dot(&east), right.dot(&north), down.dot(&north)))
}

/// xᵖ·yᵠ of every TPV coefficient, or `None` for the odd powers of the radius (3, 11, 23, 39).
pub(super) fn tpv_exponents(index: usize) -> Option<(i32, i32)> {
    // The orders begin at 0, 1, 4, 7, 12, 17, 24, 31.
    const FIRST: [usize; 8] = [0, 1, 4, 7, 12, 17, 24, 31];
    let order = FIRST.iter().rposition(|first| *first <= index)?;
    let q = index - FIRST[order];
    let power = |k: usize| i32::try_from(k).ok();
    power(order.checked_sub(q)?).zip(power(q))
}

fn tpv(coefficients: &[f64; TPV_COUNT], x: f64, y: f64) -> f64 {
    let r = x.hypot(y);
    let term = |(index, c): (usize, &f64)| match (tpv_exponents(index), index) {
        (Some((p, q)), _) => c * x.powi(p) * y.powi(q),
        (None, 3) => c * r,
        (None, 11) => c * r.powi(3),
        (None, 23) => c * r.powi(5),
        (None, _) => c * r.powi(7),
    };
    coefficients.iter().enumerate().filter(|(_, c)| **c != 0.0).map(term).sum()
}

impl Wcs {
    /// The direction (ICRS axes, unit vector) of a point counted from 0.
    pub(super) fn direction(&self, pixel_px: [f64; 2]) -> [f64; 3] {
        let [u, v] = [0, 1].map(|k| pixel_px[k] + 1.0 - self.crpix[k]);
        let [u, v] = match &self.distortion {
            Distortion::Sip(polynomials) => {
                let sum = |k: usize| polynomials[k].iter().map(|(i, j, c)| c * u.powi(*i) * v.powi(*j)).sum::<f64>();
                [u + sum(0), v + sum(1)]
            }
            _ => [u, v],
        };
        let plane = self.cd_rad * nalgebra::Vector2::new(u, v);
        let (mut xi, mut eta) = (plane.x, plane.y);
        if let Distortion::Tpv(pv) = &self.distortion {
            let degrees = [xi.to_degrees(), eta.to_degrees()];
            (xi, eta) = (tpv(&pv[0], degrees[0], degrees[1]).to_radians(), tpv(&pv[1], degrees[1], degrees[0]).to_radians());
        }
        let [east, north, out] = axes(self.crval_rad);
        let sum = (east * xi + north * eta + out).normalize();
        [sum.x, sum.y, sum.z]
    }

    /// The whole map's derivative at CRPIX, rad per pixel: CD and the polynomials' own terms of first order.
    fn slope_rad(&self) -> Matrix2<f64> {
        match &self.distortion {
            Distortion::None => self.cd_rad,
            Distortion::Sip(polynomials) => {
                let term = |axis: usize, i: i32, j: i32| -> f64 {
                    polynomials[axis].iter().filter(|(p, q, _)| (*p, *q) == (i, j)).map(|(.., c)| c).sum()
                };
                self.cd_rad * Matrix2::new(1.0 + term(0, 1, 0), term(0, 0, 1), term(1, 1, 0), 1.0 + term(1, 0, 1))
            }
            Distortion::Tpv(pv) => Matrix2::new(pv[0][1], pv[0][2], pv[1][2], pv[1][1]) * self.cd_rad,
        }
    }

    /// What the directions of a header are, as far as it says.
    pub(super) fn meaning(file: &str, bytes: &[u8]) -> Option<Meaning> {
        let cards = Cards::read(file, bytes).ok()?;
        let (_, name, _) = cards.text("WCSNAME")?;
        [Meaning::Catalog, Meaning::Apparent].into_iter().find(|meaning| meaning.name() == name)
    }

    /// −1 if the frame is mirrored.
    pub(super) fn parity(&self) -> i8 {
        if self.slope_rad().determinant() < 0.0 { -1 } else { 1 }
    }

    /// The attitude of the un-mirrored camera that the derivative at CRPIX says, and its focal lengths along columns and rows, px.
    pub(super) fn attitude(&self) -> (Attitude, [f64; 2]) {
        let [east, north, out] = axes(self.crval_rad);
        let slope = self.slope_rad();
        let column = |k: usize| slope.column(k).into_owned();
        let lengths = [column(0).norm(), column(1).norm()];
        let along = |k: usize, sign: f64| (east * column(k).x + north * column(k).y) * (sign / lengths[k]);
        let (right, down) = (along(0, f64::from(self.parity())), along(1, 1.0));
        // Half of what the two lack of a right angle goes to each.
        let (sum, difference) = ((right + down).normalize(), (right - down).normalize());
        let right = (sum + difference).normalize();
        let rows = nalgebra::Matrix3::from_rows(&[right.transpose(), out.cross(&right).transpose(), out.transpose()]);
        let rotation = Rotation3::from_matrix_unchecked(rows);
        (Attitude::new(nalgebra::UnitQuaternion::from_rotation_matrix(&rotation)), lengths.map(|length| 1.0 / length))
    }

    /// The header as the bytes of a FITS file without data; `inverse` holds SIP's polynomials from the sky to the pixel.
    pub(super) fn header(&self, inverse: Option<&Polynomials>, meaning: Meaning, comments: &[String]) -> Vec<u8> {
        let projection = match self.distortion {
            Distortion::None => "TAN",
            Distortion::Sip(_) => "TAN-SIP",
            Distortion::Tpv(_) => "TPV",
        };
        let mut cards = vec![
            card("SIMPLE", "T"),
            card("BITPIX", "8"),
            card("NAXIS", "0"),
            card("WCSAXES", "2"),
            card("WCSNAME", &format!("'{}'", meaning.name())),
            card("CTYPE1", &format!("'RA---{projection}'")),
            card("CTYPE2", &format!("'DEC--{projection}'")),
            card("CUNIT1", "'deg     '"),
            card("CUNIT2", "'deg     '"),
            card("RADESYS", "'ICRS    '"),
        ];
        for k in 0..2 {
            cards.push(card(&format!("CRPIX{}", k + 1), &real(self.crpix[k])));
            cards.push(card(&format!("CRVAL{}", k + 1), &real(self.crval_rad[k].to_degrees())));
        }
        for (row, column) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
            cards.push(card(&format!("CD{}_{}", row + 1, column + 1), &real(self.cd_rad[(row, column)].to_degrees())));
        }
        if let Some([width, height]) = self.size_px {
            cards.extend([card("IMAGEW", &width.to_string()), card("IMAGEH", &height.to_string())]);
        }
        let mut polynomials = |names: [&str; 2], both: &Polynomials| {
            for (name, terms) in names.into_iter().zip(both) {
                let order = terms.iter().map(|(i, j, _)| i + j).max().unwrap_or(0);
                cards.push(card(&format!("{name}_ORDER"), &order.to_string()));
                cards.extend(terms.iter().map(|(i, j, c)| card(&format!("{name}_{i}_{j}"), &real(*c))));
            }
        };
        if let Distortion::Sip(forward) = &self.distortion {
            polynomials(["A", "B"], forward);
            if let Some(inverse) = inverse {
                polynomials(["AP", "BP"], inverse);
            }
        }
        if let Distortion::Tpv(pv) = &self.distortion {
            for (axis, coefficients) in pv.iter().enumerate() {
                let used = coefficients.iter().enumerate().filter(|(index, c)| **c != 0.0 || *index == 1);
                cards.extend(used.map(|(index, c)| card(&format!("PV{}_{index}", axis + 1), &real(*c))));
            }
        }
        for comment in comments {
            let words: Vec<char> = comment.chars().map(|c| if c.is_ascii() && !c.is_ascii_control() { c } else { '?' }).collect();
            let mut line = String::new();
            for word in words.split(|c| *c == ' ').map(|word| word.iter().collect::<String>()) {
                if !line.is_empty() && line.len() + 1 + word.len() > COMMENT {
                    cards.push(comment_card(&line));
                    line.clear();
                }
                line = if line.is_empty() { word } else { line + " " + &word };
            }
            cards.push(comment_card(&line));
        }
        cards.push(format!("{:<CARD$}", "END"));
        let mut bytes = cards.concat().into_bytes();
        bytes.resize(bytes.len().div_ceil(BLOCK) * BLOCK, b' ');
        bytes
    }

    /// Reads the cards of a header: of a FITS file's first part, or text with one card a line.
    pub(super) fn read(file: &str, bytes: &[u8]) -> Result<Self, ExchangeError> {
        let cards = Cards::read(file, bytes)?;
        let kind = cards.required_text("CTYPE1")?;
        let other = cards.required_text("CTYPE2")?;
        let projection = match (kind.as_str(), other.as_str()) {
            ("RA---TAN", "DEC--TAN") => "TAN",
            ("RA---TAN-SIP", "DEC--TAN-SIP") => "SIP",
            ("RA---TPV", "DEC--TPV") => "TPV",
            _ => {
                let problem =
                    format!("CTYPE {kind:?} and {other:?} are not read here; RA---TAN, RA---TAN-SIP and RA---TPV with their DEC are");
                return Err(ExchangeError::of(file, problem));
            }
        };
        if let Some(value) = cards.number("LONPOLE")?.filter(|value| *value != 180.0) {
            return Err(ExchangeError::of(file, format!("LONPOLE = {value} is not read here; it must be 180 or absent")));
        }
        let crpix = [cards.required("CRPIX1")?, cards.required("CRPIX2")?];
        let crval_rad = [cards.required("CRVAL1")?.to_radians(), cards.required("CRVAL2")?.to_radians()];
        let mut cd = Matrix2::zeros();
        let with_cd = cards.number("CD1_1")?.is_some() || cards.number("CD1_2")?.is_some();
        for (row, column) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
            cd[(row, column)] = if with_cd {
                cards.number(&format!("CD{}_{}", row + 1, column + 1))?.unwrap_or(0.0)
            } else {
                let one = if row == column { 1.0 } else { 0.0 };
                cards.required(&format!("CDELT{}", row + 1))? * cards.number(&format!("PC{}_{}", row + 1, column + 1))?.unwrap_or(one)
            };
        }
        let cd_rad = cd.map(f64::to_radians);
        if cd_rad.determinant().abs() <= 1e-30 {
            return Err(ExchangeError::of(
                file,
                format!("the matrix CD = {cd:?} has no inverse; it says no scale of the image").replace('\n', " "),
            ));
        }
        let distortion = match projection {
            "SIP" => Distortion::Sip([cards.sip("A")?, cards.sip("B")?]),
            "TPV" => Distortion::Tpv(Box::new([cards.tpv(1)?, cards.tpv(2)?])),
            _ => Distortion::None,
        };
        let side = |keys: [&str; 2]| -> Result<Option<usize>, ExchangeError> {
            let value = [cards.number(keys[0])?, cards.number(keys[1])?].into_iter().flatten().find(|value| *value >= 1.0);
            Ok(value.map(|value| value as usize))
        };
        let size_px = side(["IMAGEW", "NAXIS1"])?.zip(side(["IMAGEH", "NAXIS2"])?).map(|(width, height)| [width, height]);
        let wcs = Self { crpix, crval_rad, cd_rad, distortion, size_px };
        if wcs.slope_rad().determinant().abs() <= 1e-30 {
            return Err(ExchangeError::of(
                file,
                "the polynomials' terms of first order leave no scale of the image (PV1_1 and PV2_1 are near 1)",
            ));
        }
        Ok(wcs)
    }
}

/// A line of a comment; a word longer than the card is cut.
fn comment_card(line: &str) -> String {
    let text: String = line.chars().take(COMMENT).collect();
    format!("{:<CARD$}", format!("COMMENT {text}"))
}

fn card(key: &str, value: &str) -> String {
    let body = if value.starts_with('\'') { format!("{key:<8}= {value:<20}") } else { format!("{key:<8}= {value:>20}") };
    format!("{body:<CARD$}")
}

/// Seventeen digits: reads back to the same bits.
fn real(value: f64) -> String {
    format!("{value:.16E}")
}

/// Keys and values of a header.
struct Cards<'a> {
    file: &'a str,
    /// (key, value as it stands there, number of the card from 1)
    cards: Vec<(String, String, usize)>,
}

impl<'a> Cards<'a> {
    fn read(file: &'a str, bytes: &[u8]) -> Result<Self, ExchangeError> {
        let binary = bytes.len() > CARD && !bytes[..=CARD].contains(&b'\n');
        let pieces: Vec<&[u8]> = if binary { bytes.chunks(CARD).collect() } else { bytes.split(|byte| *byte == b'\n').collect() };
        let mut cards = Vec::new();
        let mut ended = false;
        for (index, piece) in pieces.into_iter().enumerate() {
            let text = String::from_utf8_lossy(piece);
            let key = text.split('=').next().unwrap_or_default().trim().to_owned();
            if text.trim_end() == "END" {
                ended = true;
                break;
            }
            let Some(value) = text.get(8..).and_then(|rest| rest.strip_prefix("= ")) else { continue };
            let value = match value.trim_start().strip_prefix('\'') {
                Some(quoted) => quoted.split('\'').next().unwrap_or_default().trim_end().to_owned(),
                None => value.split('/').next().unwrap_or_default().trim().to_owned(),
            };
            cards.push((key, value, index + 1));
        }
        if cards.is_empty() || (binary && !ended) {
            return Err(ExchangeError::of(file, "this is no FITS header: there are no cards that close with END"));
        }
        Ok(Self { file, cards })
    }

    fn text(&self, key: &str) -> Option<&(String, String, usize)> {
        self.cards.iter().find(|(own, ..)| own == key)
    }

    fn required_text(&self, key: &str) -> Result<String, ExchangeError> {
        self.text(key).map(|(_, value, _)| value.clone()).ok_or_else(|| self.missing(key))
    }

    fn missing(&self, key: &str) -> ExchangeError {
        ExchangeError::of(self.file, format!("{key} is missing; the header must hold world coordinates (CTYPE, CRPIX, CRVAL, CD)"))
    }

    fn number(&self, key: &str) -> Result<Option<f64>, ExchangeError> {
        let Some((_, value, line)) = self.text(key) else { return Ok(None) };
        let number = value.replace(['D', 'd'], "E").parse::<f64>().ok().filter(|number| number.is_finite());
        number.map(Some).ok_or_else(|| ExchangeError::at(self.file, *line, format!("{key} = {value:?} is no finite number")))
    }

    fn required(&self, key: &str) -> Result<f64, ExchangeError> {
        self.number(key)?.ok_or_else(|| self.missing(key))
    }

    fn sip(&self, name: &str) -> Result<Vec<(i32, i32, f64)>, ExchangeError> {
        let order = self.required(&format!("{name}_ORDER"))?;
        if !(0.0..=SIP_MAXIMUM as f64).contains(&order) {
            return Err(ExchangeError::of(self.file, format!("{name}_ORDER = {order} is out of range; SIP has 0 to {SIP_MAXIMUM}")));
        }
        let mut terms = Vec::new();
        for i in 0..=order as i32 {
            for j in 0..=order as i32 - i {
                if let Some(value) = self.number(&format!("{name}_{i}_{j}"))? {
                    terms.push((i, j, value));
                }
            }
        }
        Ok(terms)
    }

    fn tpv(&self, axis: usize) -> Result<[f64; TPV_COUNT], ExchangeError> {
        let mut coefficients = [0.0; TPV_COUNT];
        coefficients[1] = 1.0; // the convention's default
        for (index, coefficient) in coefficients.iter_mut().enumerate() {
            if let Some(value) = self.number(&format!("PV{axis}_{index}"))? {
                *coefficient = value;
            }
        }
        Ok(coefficients)
    }
}
