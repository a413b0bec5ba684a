//! Bias of a centroid that follows the pixel phase and the brightness, predicted from the image of a star.
//!
//! Whatever the estimator, it is fitted to the image drawn without noise at places all over the pixel. The mean over the phases of a faint star is left
//! alone: it is the estimator's choice of what the centre of a lopsided image is, smooth over the frame, and no error that a camera model could not hold.
//! Of a bright star the mean is another, since the noise of its own light takes weight from the core: a lopsided image moves with the brightness, as by a
//! magnitude equation. What is left is this difference and a Fourier series of the phases along both axes, to second order, at a few places of the frame,
//! brightnesses, colours and temperatures; a star's bias lies between these. Full pixels take no part in a fit: of a star that has some the bias is
//! another, and often the opposite.

use std::f64::consts::PI;

use super::epsf::{Conditions, EmpiricalPsf};
use super::fit::{Freedom, SNR_FOR_WIDTH};
use super::image_model::{Model, Window, radius_px};
use super::psf::Profile;
use super::stamp::{Photons, Stamp};
use super::windowed;
use crate::frame::Frame;
use crate::parallel;
use crate::statistics::cholesky::inverse;

/// How places were measured.
#[derive(Clone, Copy, Debug)]
pub enum Estimator<'a> {
    /// By a Gaussian.
    Gaussian,
    /// By an image that the stars' own pixels tell.
    Empirical(&'a EmpiricalPsf),
    /// In a Gaussian window for images of this width (σ before the pixel integrates it), px.
    Windowed(f64),
}

/// The noise of a pixel, and where it is full.
#[derive(Clone, Copy, Debug)]
pub struct PixelNoise {
    /// Variance of the sky's counts.
    pub sky_dn2: f64,
    /// Variance per count of a star's light: 1 / gain.
    pub per_dn: f64,
    /// Counts above the sky at which a pixel is full and takes no part; infinite where none is.
    pub full_dn: f64,
}

/// A star whose bias is asked for.
#[derive(Clone, Copy, Debug)]
pub struct BiasedStar {
    /// Column and row, as measured.
    pub at_px: [f64; 2],
    /// Flux, DN.
    pub flux_dn: f64,
    /// Colour and temperature as departures from the usual.
    pub conditions: Conditions,
}

/// Phases along an axis, which tell a Fourier series of second order.
const PHASES: usize = 5;
/// Numbers of the series of both axes.
const TERMS: usize = PHASES * PHASES;
/// What the series is tabulated over: column, row, logarithm of the flux, colour, temperature.
const AXES: usize = 5;
type Series = [[f64; TERMS]; 2];

/// The bias of the places of a recording's stars.
#[derive(Clone, Debug)]
pub struct PhaseBias {
    nodes: [Vec<f64>; AXES],
    /// The last axis fastest.
    series: Vec<Series>,
}

impl PhaseBias {
    /// Of an estimator under an image, over the range of these stars; nothing where it cannot fit the image.
    #[must_use]
    pub fn predict(psf: &EmpiricalPsf, estimator: Estimator<'_>, noise: PixelNoise, stars: &[BiasedStar]) -> Option<Self> {
        let along = |values: Vec<f64>, is_in_it: bool, count: usize| nodes(values, if is_in_it { count } else { 1 });
        let is_in_field = psf.field_order() > 0;
        let of = |value: fn(&BiasedStar) -> f64| stars.iter().map(value).collect::<Vec<f64>>();
        let nodes = [
            along(of(|star| star.at_px[0]), is_in_field, 3)?,
            along(of(|star| star.at_px[1]), is_in_field, 3)?,
            flux_nodes(of(|star| star.flux_dn.max(f64::MIN_POSITIVE).ln()), |flux_dn| has_free_width(psf, estimator, noise, flux_dn))?,
            along(of(|star| star.conditions[0]), psf.terms.by[0], 2)?,
            along(of(|star| star.conditions[1]), psf.terms.by[1], 2)?,
        ];
        let count = nodes.iter().map(Vec::len).product::<usize>();
        let series = |index: usize| {
            let mut left = index;
            let mut at = [0.0; AXES];
            for axis in (0..AXES).rev() {
                at[axis] = nodes[axis][left % nodes[axis].len()];
                left /= nodes[axis].len();
            }
            series(&psf.under([at[3], at[4]]), estimator, noise, [at[0], at[1]], at[2].exp())
        };
        let found = parallel::map_numbers(count, series);
        let (nodes, mut series) = with_fits(nodes, found)?;
        let fluxes = nodes[2].len();
        take_faintest_means_off(&mut series, fluxes, nodes[3].len() * nodes[4].len());
        Some(Self { nodes, series })
    }

    /// Measured less true place along both axes, px.
    #[must_use]
    pub fn at(&self, star: &BiasedStar) -> [f64; 2] {
        let at = [star.at_px[0], star.at_px[1], star.flux_dn.max(f64::MIN_POSITIVE).ln(), star.conditions[0], star.conditions[1]];
        let mut corners = vec![(0, 1.0)];
        for (nodes, at) in self.nodes.iter().zip(at) {
            let (low, share) = between(nodes, at);
            let both = |(index, weight): (usize, f64)| {
                let first = index * nodes.len() + low;
                [(first, weight * (1.0 - share)), (first + usize::from(share > 0.0), weight * share)]
            };
            corners = corners.into_iter().flat_map(both).filter(|(_, weight)| *weight > 0.0).collect();
        }
        let basis = basis(star.at_px.map(|along| along - along.round()));
        [0, 1].map(|axis| {
            let of = |(index, weight): &(usize, f64)| -> f64 {
                weight * self.series[*index][axis].iter().zip(&basis).map(|(number, term)| number * term).sum::<f64>()
            };
            corners.iter().map(of).sum()
        })
    }
}

/// Nodes over what most of the values span.
fn nodes(mut values: Vec<f64>, count: usize) -> Option<Vec<f64>> {
    /// Share of the values beyond the outermost.
    const BEYOND: f64 = 0.03;
    values.retain(|value| value.is_finite());
    values.sort_by(f64::total_cmp);
    let at = |share: f64| values.get((share * (values.len().max(1) - 1) as f64).round() as usize).copied();
    let (low, high) = (at(BEYOND)?, at(1.0 - BEYOND)?);
    if count == 1 || high <= low {
        return Some(vec![at(0.5)?]);
    }
    Some((0..count).map(|k| low + (high - low) * k as f64 / (count - 1) as f64).collect())
}

/// Nodes over the logarithm of the flux, up to the brightest star: bright stars say most of a bias, and theirs is another than that of faint ones, since the
/// core's pixels count less the more noise the star's own light makes. On both sides of the flux from which on the width is fitted there is one.
fn flux_nodes(ln_fluxes: Vec<f64>, has_free_width: impl Fn(f64) -> bool) -> Option<Vec<f64>> {
    /// Distance of nodes, and how many at most.
    const STEP: f64 = 0.5;
    const MAX_NODES: usize = 12;
    /// Where the width is fitted scatters about its flux by so much.
    const SCATTER: f64 = 0.1;
    const HALVINGS: usize = 12;
    let high = ln_fluxes.iter().copied().filter(|value| value.is_finite()).max_by(f64::total_cmp)?;
    let low = *nodes(ln_fluxes, 2)?.first()?;
    let count = (((high - low) / STEP).ceil() as usize + 1).clamp(1, MAX_NODES);
    let mut found: Vec<f64> = (0..count).map(|k| low + (high - low) * k as f64 / (count - 1).max(1) as f64).collect();
    if !has_free_width(low.exp()) && has_free_width(high.exp()) {
        let mut about = [low, high];
        for _ in 0..HALVINGS {
            let middle = f64::midpoint(about[0], about[1]);
            about[usize::from(has_free_width(middle.exp()))] = middle;
        }
        found.extend([about[0] - SCATTER, about[1] + SCATTER].into_iter().filter(|node| low < *node && *node < high));
        found.sort_by(f64::total_cmp);
    }
    Some(found)
}

/// The table without the fluxes at which a drawn star has no fit, as one that is full all over: brighter stars have the bias of the last node then.
/// Nothing where none is left.
fn with_fits(mut nodes: [Vec<f64>; AXES], found: Vec<Option<Series>>) -> Option<([Vec<f64>; AXES], Vec<Series>)> {
    let faster = nodes[3].len() * nodes[4].len();
    let mut has_fit = vec![true; nodes[2].len()];
    for (index, series) in found.iter().enumerate() {
        let flux = index / faster % has_fit.len();
        has_fit[flux] &= series.is_some();
    }
    let series = found.into_iter().enumerate().filter(|(index, _)| has_fit[index / faster % has_fit.len()]).filter_map(|(_, own)| own);
    let series: Vec<Series> = series.collect();
    let mut fits = has_fit.iter();
    nodes[2].retain(|_| *fits.next().unwrap_or(&false));
    (!nodes[2].is_empty()).then_some((nodes, series))
}

/// Takes the mean over the phases that the faintest star has off that of all stars at its place and under its conditions.
fn take_faintest_means_off(series: &mut [Series], fluxes: usize, faster: usize) {
    for of_place in series.chunks_exact_mut(fluxes * faster) {
        let faintest: Vec<[f64; 2]> = of_place[..faster].iter().map(|series| series.map(|axis| axis[0])).collect();
        for (index, series) in of_place.iter_mut().enumerate() {
            for (axis, mean) in series.iter_mut().zip(faintest[index % faster]) {
                axis[0] -= mean;
            }
        }
    }
}

/// The node before a value, and its share of the way to the next.
fn between(nodes: &[f64], at: f64) -> (usize, f64) {
    let after = nodes.partition_point(|node| *node <= at);
    if after == 0 {
        return (0, 0.0);
    }
    let low = after - 1;
    nodes.get(after).map_or((low, 0.0), |next| (low, (at - nodes[low]) / (next - nodes[low])))
}

/// 1, cos φ, sin φ, cos 2φ, sin 2φ of an axis times those of the other.
fn basis(phase_px: [f64; 2]) -> [f64; TERMS] {
    let [x, y] = phase_px.map(|phase| {
        let (one, two) = ((std::f64::consts::TAU * phase).sin_cos(), (2.0 * std::f64::consts::TAU * phase).sin_cos());
        [1.0, one.1, one.0, two.1, two.0]
    });
    std::array::from_fn(|k| x[k % PHASES] * y[k / PHASES])
}

/// The series at a place of the frame.
fn series(psf: &EmpiricalPsf, estimator: Estimator<'_>, noise: PixelNoise, at_px: [f64; 2], flux_dn: f64) -> Option<Series> {
    let seat = |axis: usize, radius: f64| at_px[axis].round().clamp(radius, (psf.size_px[axis] - 1.0 - radius).max(radius));
    let mut series = [[0.0; TERMS]; 2];
    for k in 0..TERMS {
        let phase = [k % PHASES, k / PHASES].map(|step| step as f64 / PHASES as f64 - 0.4);
        let radius = radius_px(psf.base);
        let at = [0, 1].map(|axis| seat(axis, radius as f64) + phase[axis]);
        let found = estimate(psf, estimator, noise, at, flux_dn)?;
        for (number, term) in basis(phase).into_iter().enumerate() {
            // Squares of a term over all phases: all of them of the mean along an axis, half of the others.
            let halves = usize::from(number % PHASES > 0) + usize::from(number / PHASES > 0);
            let scale = f64::from(1_u32 << halves) / TERMS as f64;
            for axis in 0..2 {
                series[axis][number] += scale * term * (found[axis] - at[axis]);
            }
        }
    }
    Some(series)
}

/// A star drawn without noise, as fits see it.
struct DrawnStar {
    model: Model,
    is_full: bool,
    stamp: Stamp,
    photons: Photons,
}

impl DrawnStar {
    fn new(psf: &EmpiricalPsf, noise: PixelNoise, at: [f64; 2], flux_dn: f64) -> Self {
        let lone = Self::in_window(psf, noise, at, flux_dn, 0);
        let full = lone.stamp.used.iter().filter(|used| !**used).count();
        // The window of a star with full pixels is larger by their radius.
        if full == 0 { lone } else { Self::in_window(psf, noise, at, flux_dn, (full as f64 / PI).sqrt().ceil() as usize) }
    }

    fn in_window(psf: &EmpiricalPsf, noise: PixelNoise, at: [f64; 2], flux_dn: f64, wider: usize) -> Self {
        let radius = radius_px(psf.base) + wider;
        let model = Model { x: at[0], y: at[1], flux_dn, shape: psf.base, radius, empirical: true };
        let side = 2 * radius + 1;
        let corner = |axis: usize| (at[axis].round() as usize).saturating_sub(radius);
        let window = Window { x0: corner(0), y0: corner(1), columns: side, rows: side };
        let mut profile = Profile::of(Some(psf));
        profile.draw(window, &model, false);
        let data: Vec<f64> = profile.value.iter().map(|share| flux_dn * share).collect();
        let used: Vec<bool> = data.iter().map(|value| *value < noise.full_dn).collect();
        let (peak_dn, pixels) = (data.iter().copied().fold(0.0, f64::max), data.len());
        let is_full = used.contains(&false);
        let stamp = Stamp { window, data, variance: vec![noise.sky_dn2; pixels], used, edge: false, peak_dn };
        Self { model, is_full, stamp, photons: Photons { variance_per_dn: noise.per_dn } }
    }

    fn fit(&self, start: Model, freedom: Freedom, profile: &mut Profile<'_>) -> Option<(Model, f64)> {
        self.photons.settle(&mut self.stamp.clone(), Model { empirical: freedom == Freedom::Empirical, ..start }, freedom, profile)
    }

    /// Of a Gaussian of known width: the fit, and whether the star is so bright that its width is fitted too.
    fn of_known_width(&self, profile: &mut Profile<'_>) -> Option<((Model, f64), bool)> {
        let fixed = self.fit(self.model, Freedom::Fixed, profile)?;
        profile.draw(self.stamp.window, &fixed.0, false);
        let own = inverse(&self.photons.normal(&self.stamp, profile, fixed.0.flux_dn, fixed.1, 4).matrix, 4)?;
        Some((fixed, fixed.0.flux_dn > SNR_FOR_WIDTH * own[0][0].sqrt()))
    }
}

/// Whether the width of a star of such a flux, in the middle of the frame and of its pixel, is fitted too; also where so little of it is not full that
/// no fit of known width is found.
fn has_free_width(psf: &EmpiricalPsf, estimator: Estimator<'_>, noise: PixelNoise, flux_dn: f64) -> bool {
    if !matches!(estimator, Estimator::Gaussian) {
        return false;
    }
    let star = DrawnStar::new(psf, noise, psf.size_px.map(|size| (0.5 * size).round()), flux_dn);
    star.of_known_width(&mut Profile::new()).is_none_or(|(_, is_bright)| is_bright)
}

/// Where the estimator sees a star that is drawn without noise.
fn estimate(psf: &EmpiricalPsf, estimator: Estimator<'_>, noise: PixelNoise, at: [f64; 2], flux_dn: f64) -> Option<[f64; 2]> {
    let star = DrawnStar::new(psf, noise, at, flux_dn);
    let found = match estimator {
        Estimator::Windowed(sigma_px) => {
            let (window, radius) = (star.stamp.window, star.model.radius as f64);
            let pixels_dn = star.stamp.data.iter().map(|value| *value as f32).collect();
            let frame = Frame { width_px: window.columns, height_px: window.rows, pixels_dn, saturation_dn: f32::INFINITY };
            let found = windowed::centre(&frame, [radius; 2], sigma_px)?;
            return Some([found[0] + window.x0 as f64, found[1] + window.y0 as f64]);
        }
        Estimator::Empirical(own) => star.fit(Model { shape: own.base, ..star.model }, Freedom::Empirical, &mut Profile::of(Some(own)))?.0,
        Estimator::Gaussian => {
            let mut profile = Profile::new();
            let (fixed, is_bright) = star.of_known_width(&mut profile)?;
            let freedom = if psf.base.is_round() || star.is_full { Freedom::Width } else { Freedom::Ellipse };
            if is_bright || star.is_full { star.fit(fixed.0, freedom, &mut profile).unwrap_or(fixed).0 } else { fixed.0 }
        }
    };
    Some([found.x, found.y])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two rows and three fluxes, of which the brightest has no fit in one of the rows.
    #[test]
    fn a_flux_without_a_fit_leaves_the_table() {
        let series = |value: f64| Some([[value; TERMS]; 2]);
        let nodes = || [vec![10.0], vec![20.0, 30.0], vec![7.0, 8.0, 9.0], vec![0.0], vec![0.0]];
        let table = vec![series(1.0), series(2.0), series(3.0), series(4.0), series(5.0), None];
        let (kept, found) = with_fits(nodes(), table).unwrap();
        assert_eq!(kept[2], [7.0, 8.0]);
        assert_eq!(found.iter().map(|own| own[0][0]).collect::<Vec<_>>(), [1.0, 2.0, 4.0, 5.0]);
        assert!(with_fits(nodes(), vec![None; 6]).is_none());
    }
}
