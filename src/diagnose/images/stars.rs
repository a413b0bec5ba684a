//! Rows of stars: magnitude less the catalogue's, second moments, skewness; and the columns that effects and causes have there.

use std::collections::BTreeMap;

use super::expected_stars::{StarMeasurement, expected_bright};
use super::rendered::{self, RenderedColumn, StampCamera};
use super::rows::{Kind, Parameter, Question, Row, Rows, Shared, Shown};
use crate::diagnose::causes::IMAGE_CAUSES;
use crate::diagnose::channels::Channel;
use crate::effects::{IMAGE_EFFECTS, ImageEffect, ImageResponse, MAGNITUDES};

/// Name of the rows that tell the brightness of stars.
pub(super) const MAGNITUDE: &str = "magnitude less the catalogue's";
/// Name of the rows that tell the size of images.
pub(super) const SIZE: &str = "size of the image";
/// Of those that tell their elongation along x and along the diagonal.
pub(super) const ELONGATION: &str = "elongation along x";
pub(super) const DIAGONAL: &str = "elongation along the diagonal";
/// Harmonics of the place in the pixel that are nuisance parameters, and the rows that there must be.
const HARMONICS: &[(f64, usize)] = &[(1.0, 60), (2.0, 200)];
/// Fewer rows of a kind are no kind.
pub(super) const MIN_ROWS: usize = 30;
/// An effect is asked for where so large a part of the stars has what it depends on.
const MIN_KNOWN: f64 = 0.75;

/// The kinds in which a star has rows, in this order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum StarKind {
    Magnitude,
    Size,
    Elongation,
    Diagonal,
    SkewX,
    SkewY,
}

impl StarKind {
    const ALL: [Self; 6] = [Self::Magnitude, Self::Size, Self::Elongation, Self::Diagonal, Self::SkewX, Self::SkewY];

    fn name(self) -> &'static str {
        match self {
            Self::Magnitude => MAGNITUDE,
            Self::Size => SIZE,
            Self::Elongation => ELONGATION,
            Self::Diagonal => DIAGONAL,
            Self::SkewX => "skewness along x",
            Self::SkewY => "skewness along y",
        }
    }

    fn channel(self) -> Channel {
        if self == Self::Magnitude { Channel::Flux } else { Channel::Shape }
    }

    /// Value and standard error.
    fn measured(self, star: &StarMeasurement) -> Option<[f64; 2]> {
        if self == Self::Magnitude {
            let is_told = star.magnitude.is_finite() && star.magnitude < 90.0;
            return is_told.then(|| [-2.5 * star.flux_dn.log10() - star.magnitude, MAGNITUDES * star.flux_sigma_dn / star.flux_dn]);
        }
        let moments = star.moments?;
        let ([xx, xy, yy], [sxx, sxy, syy]) = (moments.second_px2, moments.second_sigma_px2);
        let half = 0.5 * sxx.hypot(syy);
        let [value, sigma] = match self {
            Self::Size => [0.5 * (xx + yy), half],
            Self::Elongation => [0.5 * (xx - yy), half],
            Self::Diagonal => [xy, sxy],
            Self::SkewX => [moments.skewness[0], moments.skewness_sigma[0]],
            Self::SkewY | Self::Magnitude => [moments.skewness[1], moments.skewness_sigma[1]],
        };
        (value.is_finite() && sigma > 0.0 && sigma.is_finite()).then_some([value, sigma])
    }

    fn of(self, response: &ImageResponse) -> f64 {
        let [xx, xy, yy] = response.second_px2;
        match self {
            Self::Magnitude => response.magnitude,
            Self::Size => 0.5 * (xx + yy),
            Self::Elongation => 0.5 * (xx - yy),
            Self::Diagonal => xy,
            Self::SkewX => response.skewness[0],
            Self::SkewY => response.skewness[1],
        }
    }
}

/// A star's row of a kind.
struct Told<'a> {
    kind: usize,
    of: StarKind,
    star: &'a StarMeasurement,
}

/// Rows of the stars with the questions of all effects and causes; what was not asked and why; and the stars that have rows, what depends on their
/// brightness at the expected one. Where it is known how the stars are rendered, columns are rendered.
pub(super) fn rows_of_stars(
    stars: &[StarMeasurement],
    frames: usize,
    stamps: Option<&StampCamera>,
) -> (Rows, BTreeMap<&'static str, String>, Vec<StarMeasurement>) {
    let mut rows = Rows { frames, ..Rows::default() };
    let stars = expected_bright(stars);
    let mut told: Vec<Told<'_>> = Vec::new();
    for of in StarKind::ALL {
        let own: Vec<(&StarMeasurement, [f64; 2], f64)> =
            stars.iter().filter_map(|own| Some((&own.star, of.measured(&own.star)?, own.snr))).collect();
        if own.len() < MIN_ROWS {
            continue;
        }
        let kind = rows.kinds.len();
        told.extend(own.iter().map(|(star, ..)| Told { kind, of, star }));
        let row = |(star, [value, sigma], _): &(&StarMeasurement, [f64; 2], f64)| Row {
            value: *value,
            sigma: *sigma,
            frame: star.frame,
            star: star.star,
            point: Some(star.point),
        };
        let one = vec![1.0; own.len()];
        // A fit to noise is biased in proportion to the inverse square of the signal-to-noise ratio (Box 1971, J. R. Stat. Soc. B 33, 171).
        let bias: Vec<f64> = own.iter().map(|(_, _, snr)| snr.powi(-2)).collect();
        let is_flux = of == StarKind::Magnitude;
        let mut common = if is_flux { vec![bias] } else { vec![one.clone(), bias] };
        common.extend(phases(&own.iter().map(|(star, ..)| star.image.phase_px).collect::<Vec<_>>()));
        rows.kinds.push(Kind {
            channel: of.channel(),
            name: of.name(),
            rows: own.iter().map(row).collect(),
            per_frame: if is_flux { vec![one] } else { Vec::new() },
            common,
            shared: if is_flux { Shared::Star } else { Shared::Frame },
            is_scaled: true,
        });
    }
    let mut unasked = BTreeMap::new();
    let rendered = stamps.map_or_else(Vec::new, |stamps| rendered::of_images(&stars, stamps));
    for effect in IMAGE_EFFECTS.iter().chain(IMAGE_CAUSES) {
        match question(*effect, &told, rendered.iter().find(|own| own.id == effect.id())) {
            Ok(question) => {
                rows.questions.extend(effect.parts().iter().map(|part| question.part(part, effect.part_follows(part))));
                rows.questions.push(question);
            }
            Err(reason) => {
                unasked.entry(effect.id()).or_insert(reason);
            }
        }
    }
    for column in stamps.map_or_else(Vec::new, |stamps| rendered::of_displacements(&stars, stamps)) {
        rows.questions.extend(question_of(&column, &told));
    }
    (rows, unasked, stars.iter().map(|own| own.star).collect())
}

/// What pixels make of an image that is the same everywhere goes with its place in the pixel, with a period of one; what it is nobody has declared.
fn phases(phase_px: &[[f64; 2]]) -> Vec<Vec<f64>> {
    let harmonics = HARMONICS.iter().take_while(|(_, rows)| phase_px.len() >= *rows).map(|(harmonic, _)| *harmonic);
    let column = |axis: usize, harmonic: f64, of: fn(f64) -> f64| {
        phase_px.iter().map(|phase| of(std::f64::consts::TAU * harmonic * phase[axis])).collect::<Vec<f64>>()
    };
    harmonics
        .flat_map(|harmonic| [0, 1].into_iter().flat_map(move |axis| [f64::sin, f64::cos].map(|of| (axis, harmonic, of as fn(f64) -> f64))))
        .map(|(axis, harmonic, of)| column(axis, harmonic, of))
        .collect()
}

/// The question of a column that was rendered; nothing where too few stars have it.
fn question_of(column: &RenderedColumn, told: &[Told<'_>]) -> Option<Question> {
    let values: Vec<Option<f64>> = told.iter().map(|own| Some(own.of.of(column.responses.get(&own.star.point)?))).collect();
    let known = values.iter().flatten().count();
    if (known as f64) < MIN_KNOWN * told.len() as f64 || known == 0 {
        return None;
    }
    let (name, unit) = column.parameter;
    let parameters = vec![Parameter { name, unit, shown: Shown::Same }];
    // A star that cannot be rendered is held to have what the others of the kind have on average: with nothing it would stand out.
    let mut sums: BTreeMap<usize, (f64, f64)> = BTreeMap::new();
    for (own, value) in told.iter().zip(&values).filter_map(|(own, value)| Some((own, (*value)?))) {
        let sum = sums.entry(own.kind).or_default();
        *sum = (sum.0 + value, sum.1 + 1.0);
    }
    let mean = |own: &Told<'_>| sums.get(&own.kind).map_or(0.0, |(sum, count)| sum / count);
    let columns = vec![told.iter().zip(values).map(|(own, value)| value.unwrap_or_else(|| mean(own))).collect()];
    Some(Question { id: column.id, parameters, follows: column.follows, columns, rank: 1, sign: None, is_part: false, products_of: &[] })
}

/// Columns of an effect over the rows of stars, the first as rendered where it was; or why there are none.
fn question(effect: &'static dyn ImageEffect, told: &[Told<'_>], rendered: Option<&RenderedColumn>) -> Result<Question, String> {
    let count = effect.parameters().len();
    let mut columns = vec![vec![0.0; told.len()]; count];
    let mut known = 0_usize;
    for (k, own) in told.iter().enumerate() {
        let Some(responses) = effect.responses(&own.star.image) else { continue };
        known += 1;
        for (column, response) in columns.iter_mut().zip(&responses) {
            column[k] = own.of.of(response);
        }
        if let Some(response) = rendered.and_then(|column| column.responses.get(&own.star.point)) {
            columns[0][k] = own.of.of(response);
        }
    }
    if (known as f64) < MIN_KNOWN * told.len() as f64 || told.is_empty() {
        return Err(format!("it needs {}", effect.needs()));
    }
    // A column that is zero or the same everywhere in every kind tells nothing.
    let varies = |column: &Vec<f64>| {
        let kinds = told.iter().map(|own| own.kind).max().unwrap_or(0);
        (0..=kinds).any(|kind| {
            let of: Vec<f64> = told.iter().zip(column).filter(|(own, _)| own.kind == kind).map(|(_, value)| *value).collect();
            let [low, high] = [of.iter().copied().fold(f64::INFINITY, f64::min), of.iter().copied().fold(f64::NEG_INFINITY, f64::max)];
            high - low > 1e-9 * high.abs().max(low.abs())
        })
    };
    if !columns.iter().any(varies) {
        return Err("what it depends on does not vary".to_owned());
    }
    let shown = if effect.are_squares() { Shown::Root } else { Shown::Same };
    let parameters = effect.parameters().iter().map(|(name, unit)| Parameter { name, unit, shown }).collect();
    Ok(Question {
        id: effect.id(),
        parameters,
        follows: effect.follows(),
        columns,
        rank: effect.name_rank(),
        sign: effect.sign(),
        is_part: false,
        products_of: effect.products_of(),
    })
}
