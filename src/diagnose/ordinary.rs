//! How large effects are in real cameras and skies, and whether a recording could show one of that size. "Nothing is missing" is worth as much
//! as what would have been seen.

use super::channels::Detectable;
use super::evidence::Evidence;
use super::hypotheses::{Hypothesis, with_zenith};
use super::linear_system::Whitened;
use super::stepwise::{FitState, SelectedEffect, UNOBSERVABLE, amplitude, columns, survival};
use crate::statistics::significance::neg_ln_chi2_sf;

/// A normal number is above −SURE with 95 %.
const SURE: f64 = 1.645;

/// A size that real cameras or skies have.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Size {
    /// The first parameter.
    Of(f64),
    /// The largest displacement of a star image, px: for coefficients whose numbers say little without the field.
    LargestPx(f64),
}

/// Id, size, and where it is from.
type Line = (&'static str, Size, &'static str);

/// What is ordinary. Where sources give a range, its geometric mean or what a commercial lens on a small detector has.
const ORDINARY: &[Line] = &[
    ("radial-high-order", Size::LargestPx(0.1), "0.05 to 1 px at the edge of commercial lenses (Brown 1971)"),
    ("quadratic-rest", Size::Of(0.05), "0.01 to 0.1 px (Weng, Cohen and Herniou 1992)"),
    ("thin-prism", Size::Of(0.05), "0.01 to 0.3 px (Brown 1966)"),
    ("detector-tilt", Size::Of(1.7e-3), "a tenth of a degree (Fan et al. 2020)"),
    ("pixel-aspect", Size::Of(1e-4), "1e-5 by lithography to 1e-3 by optics (Weng, Cohen and Herniou 1992)"),
    ("shear", Size::Of(1e-4), "at most 1e-4 (Weng, Cohen and Herniou 1992)"),
    ("wedge-colour", Size::Of(0.02), "0.002 to 0.05 px/mag: a window's deviation (n − 1)·α and its dispersion"),
    ("lateral-colour", Size::Of(1e-4), "0.02 to 0.1 px/mag at the edge of star trackers (SmallSat 2016), 0.2 to 1 of commercial lenses"),
    ("coma", Size::Of(0.03), "0.01 to 0.1 px/mag near the edge (Mahajan 2013)"),
    ("spiral", Size::LargestPx(0.05), "up to 0.1 px (Brown 1966)"),
    ("projection", Size::Of(1.0 / 3.0), "the cubic term of a fisheye beside a pinhole (Kannala and Brandt 2006)"),
    ("sensor-step", Size::Of(0.05), "0.01 to 1 px (Bernstein et al. 2017)"),
    ("edge-roll-off", Size::Of(0.2), "0.1 to 1 px in the last 20 px (Bradshaw et al. 2015)"),
    ("pressure-scale", Size::Of(2.7e-7), "n − 1 of air"),
    ("thermal-focal-length", Size::Of(2e-5), "1e-6 to 3e-5 per K (GIANT; Wang et al. 2015)"),
    ("thermal-distortion", Size::LargestPx(0.02), "0.5 to 2 % of the distortion (Wang et al. 2015)"),
    ("focal-length-drift", Size::Of(1e-4), "1e-4 over a night"),
    ("boresight-drift", Size::LargestPx(0.2), "4 to 70 arcsec (Lai et al. 2016)"),
    ("rolling-shutter", Size::Of(12.0), "12 µs a row (Enright and Dzamba 2012)"),
    ("stellar-aberration", Size::Of(1.0), "the Earth's velocity, 29.8 km/s"),
    ("proper-motion", Size::Of(26.0), "places of J2000.0 used in 2026"),
    ("parallax", Size::Of(1.0), "the catalogue's parallaxes"),
    ("light-deflection", Size::Of(1.0), "general relativity"),
    ("refraction", Size::Of(57.0), "air at sea level (Stone 1996)"),
    ("chromatic-refraction", Size::Of(0.4), "0.2 to 0.6 arcsec/mag without a filter (Filippenko 1982)"),
    ("frame-rotation", Size::Of(1300.0), "precession of 26 years, 50.3 arcsec a year"),
    ("time-tag", Size::Of(10.0), "a clock set by hand"),
    ("s-curve", Size::Of(0.03), "0.002 to 0.12 px by window and image width (Alexander and Ng 1991)"),
    ("even-odd", Size::Of(0.01), "0.1 to 3 % (Janesick 2007)"),
    ("bayer", Size::Of(0.3), "0.3 to 0.5 between the filters of a colour camera"),
    ("charge-transfer-inefficiency", Size::Of(0.05), "0.01 to 0.1 px (Massey et al. 2010; ACS ISR 2007-04)"),
    ("overshoot", Size::Of(0.01), "0.003 to 0.03 px (Janesick 2001)"),
    ("amplifier-step", Size::Of(0.01), "0.01 px/mag (Janesick 2001)"),
    ("stray-light", Size::Of(0.5), "0.5 electrons a pixel, 0.025 px at 1000 electrons"),
    ("magnitude-equation", Size::Of(0.01), "0.01 px/mag (Anderson and King 2000)"),
];

/// Velocity along each axis where only its components are fitted, km/s: 29.8/√3.
const VELOCITY_KM_S: f64 = 17.2;

/// The ordinary size of a hypothesis's first fitted parameter and its source; `reach_px` is the largest displacement for one unit of it.
fn ordinary(hypothesis: &Hypothesis, reach_px: f64) -> Option<(f64, &'static str)> {
    let (_, size, source) = ORDINARY.iter().find(|(id, ..)| *id == hypothesis.id())?;
    let first = *hypothesis.fitted.first()?;
    let value = match size {
        // Of a velocity that nobody knows the components are fitted, not the amplitude.
        Size::Of(_) if hypothesis.id() == "stellar-aberration" && first > 0 => VELOCITY_KM_S,
        Size::Of(value) => *value,
        Size::LargestPx(px) => px / reach_px,
    };
    value.is_finite().then_some((value, source))
}

/// Noncentrality of a χ² of `rank` degrees of freedom that exceeds, with 95 %, what has a surprise of `threshold` by chance.
///
/// Source: Sankaran's approximation of the noncentral distribution, Biometrika 50, 199 (1963).
fn needed(rank: usize, threshold: f64) -> f64 {
    let rank = rank as f64;
    let bisect = |is_enough: &dyn Fn(f64) -> bool| {
        let (mut low, mut high) = (0.0, 1e5);
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if is_enough(middle) {
                high = middle;
            } else {
                low = middle;
            }
        }
        high
    };
    let least = bisect(&|t| neg_ln_chi2_sf(rank, t) >= threshold);
    bisect(&|lambda| {
        let (mean, twice) = (rank + lambda, rank + 2.0 * lambda);
        let h = 1.0 - 2.0 / 3.0 * mean * (rank + 3.0 * lambda) / (twice * twice);
        let p = twice / (mean * mean);
        let m = (h - 1.0) * (1.0 - 3.0 * h);
        let below = (least / mean).powf(h) - (1.0 + h * p * (h - 1.0 - 0.5 * (2.0 - h) * m * p));
        below / (h * (2.0 * p).sqrt() * (1.0 + 0.5 * m * p)) <= -SURE
    })
}

/// The variant of which the ordinary size is asked: the middle one of a search; of zeniths that nobody knows one under which the frames stand
/// halfway up, as those of the table's refraction do.
fn usual_variant(evidence: &Evidence, hypothesis: &Hypothesis) -> usize {
    let height = |zenith: [f64; 3]| {
        let of = |k: usize| {
            let icrs = with_zenith(&evidence.frames[evidence.place[k]].1, zenith).zenith.unwrap_or(zenith);
            icrs.iter().zip(evidence.images[k].star_direction).map(|(a, b)| a * b).sum::<f64>()
        };
        (0..evidence.images.len()).map(of).sum::<f64>() / evidence.images.len().max(1) as f64
    };
    let off = |zenith: [f64; 3]| (height(zenith) - std::f64::consts::FRAC_1_SQRT_2).abs();
    let zeniths = hypothesis.variants.iter().enumerate().filter_map(|(index, variant)| Some((index, off(variant.zenith?))));
    zeniths.min_by(|a, b| a.1.total_cmp(&b.1)).map_or(hypothesis.variants.len() / 2, |(index, _)| index)
}

/// What the recording could have shown beside what was found, the effects that show best (in units of their ordinary size) first.
/// `threshold` is the surprise that a name needs.
pub(super) fn detectable(
    evidence: &Evidence,
    stand: &FitState,
    base: &FitState,
    found: &[SelectedEffect],
    threshold: f64,
) -> Vec<Detectable> {
    let mut all: Vec<Detectable> = Vec::new();
    for (index, hypothesis) in evidence.hypotheses.iter().enumerate() {
        if hypothesis.variants.is_empty() || found.iter().any(|entry| entry.hypothesis == index) {
            continue;
        }
        let variant = usual_variant(evidence, hypothesis);
        let Some(column) = hypothesis.variants[variant].columns.first() else { continue };
        let reach_px = column.iter().map(|[x, y]| x.hypot(*y)).fold(0.0, f64::max);
        let Some((ordinary, source)) = ordinary(hypothesis, reach_px) else { continue };
        let entry = [SelectedEffect { hypothesis: index, variant }];
        let white =
            |stand: &FitState| columns(evidence, &entry).map(|column| evidence.white(&stand.noise, column)).collect::<Vec<Whitened>>();
        let own = white(stand);
        let (_, rank) = stand.score(&own);
        let threshold = threshold + 0.5 * (hypothesis.variants.len() as f64).ln();
        // Of what attitudes and camera take up nothing is ever claimed.
        let observable = rank > 0 && survival(base, &white(base)) >= UNOBSERVABLE;
        let sigma = amplitude(stand, &own[0]).map(|[_, sigma]| sigma).filter(|sigma| observable && sigma.is_finite());
        let size_95 = sigma.map(|sigma| sigma * needed(rank, threshold).sqrt());
        let spec = &hypothesis.effect.parameters()[hypothesis.fitted[0]];
        all.push(Detectable {
            id: hypothesis.id().to_owned(),
            name: spec.name.to_owned(),
            unit: spec.unit.to_owned(),
            size_95,
            ordinary,
            source: source.to_owned(),
            would_show: size_95.is_some_and(|size| size <= ordinary),
        });
    }
    let ratio = |own: &Detectable| own.size_95.map_or(f64::INFINITY, |size| size / own.ordinary);
    all.sort_by(|a, b| ratio(a).total_cmp(&ratio(b)).then(a.id.cmp(&b.id)));
    all
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    use super::*;
    use crate::effects::{DISPLACEMENTS, Segment};

    /// Whatever is tried has an ordinary size, within what is possible, and a source.
    #[test]
    fn every_hypothesis_has_an_ordinary_size() {
        for effect in DISPLACEMENTS.iter().filter(|effect| effect.segment() != Segment::Projection && effect.id() != "brown-conrady") {
            let line = ORDINARY.iter().find(|(id, ..)| *id == effect.id());
            let (_, size, source) = line.unwrap_or_else(|| panic!("{} has no ordinary size", effect.id()));
            let (low, high) = effect.parameters()[0].range;
            assert!(!source.is_empty());
            match size {
                Size::Of(value) => assert!(*value > 0.0 && (low..=high).contains(value), "{}: {value}", effect.id()),
                Size::LargestPx(px) => assert!((0.001..1.0).contains(px), "{}", effect.id()),
            }
        }
        assert_eq!(ORDINARY.len(), ORDINARY.iter().map(|(id, ..)| id).collect::<std::collections::BTreeSet<_>>().len());
    }

    /// The size needed is one that is found with 95 %: of many draws of a normal score with that mean.
    #[test]
    fn what_is_needed_is_seen_with_95_percent() {
        const DRAWS: usize = 4000;
        let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(3);
        for (rank, threshold) in [(1_usize, 13.0), (2, 13.0), (4, 16.0)] {
            let mean = needed(rank, threshold).sqrt();
            let seen = (0..DRAWS).filter(|_| {
                let t: f64 = (0..rank)
                    .map(|k| {
                        let draw: f64 = StandardNormal.sample(&mut rng);
                        (draw + if k == 0 { mean } else { 0.0 }).powi(2)
                    })
                    .sum();
                neg_ln_chi2_sf(rank as f64, t) >= threshold
            });
            let share = seen.count() as f64 / DRAWS as f64;
            assert!((share - 0.95).abs() < 0.012, "rank {rank}: {share}");
        }
    }
}
