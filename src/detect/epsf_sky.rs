//! The ePSF learnt where the sky says that the stars are.
//!
//! Image and pixel phase are degenerate as long as every star's place is free: an error of the places that follows the phase can be traded for another
//! image (Anderson & King 2000, PASP 112, 1360, close the loop by dithers). Here the loop is closed through the sky: catalogue, camera and attitude
//! predict the places. What the prediction lacks is smooth over a frame (a refraction, a distortion that is not modelled) and is taken off as a
//! polynomial of each frame; what is left of it, as it scatters, is the standard error of the places that the sky says.

use super::epsf::{Conditions, EmpiricalPsf, PsfReport, Terms};
use super::epsf_build::{PsfStar, SkyPlace, brightest, fit_image, learn_with};
use super::fit::Freedom;
use super::image_model::Model;
use super::psf::Profile;
use crate::statistics::cholesky::{inverse, solve};
use crate::statistics::order::ascending;
use crate::statistics::{mad_sigma, median};

/// A star with its pixels, and where the sky says that it is.
#[derive(Clone)]
pub struct PredictedStar {
    /// Its pixels.
    pub star: PsfStar,
    /// Index of its frame.
    pub frame: usize,
    /// Column and row that catalogue, camera and attitude predict.
    pub predicted_px: [f64; 2],
    /// Colour and temperature as departures from the usual.
    pub conditions: Conditions,
}

/// The image that the sky's places tell.
#[derive(Clone, Debug)]
pub struct SkyImage {
    /// The image; nothing where stars held out do not prefer it.
    pub psf: Option<EmpiricalPsf>,
    /// How it was judged.
    pub report: PsfReport,
    /// Standard error of the places that the sky says, px per axis.
    pub place_sigma_px: f64,
    /// The stars that it was learnt from, at the places that the sky says, each with its index among those given.
    pub(super) learnt_from: Vec<(usize, PsfStar)>,
}

/// Pixels that are used, about: more take time.
const MAX_PIXELS: usize = 30_000;
/// Stars of a frame for a polynomial of second, of first, and of no order over it.
const MIN_STARS: [(usize, usize); 3] = [(30, 6), (12, 3), (4, 1)];
/// Standard errors beyond which a star is not where it should be: a double, a wrong name.
const MAX_OFF_SIGMA: f64 = 5.0;
/// No sky says places better, px: catalogue and turbulence.
const MIN_SIGMA_PX: f64 = 2e-3;
/// Steps of the robust fit.
const STEPS: usize = 5;

/// Learns the image of a star at the places that the sky says, as far as stars held out prefer it to Gaussians. `conditions`: whether it may change
/// with colour, and with temperature.
#[must_use]
pub fn learn_from_sky(stars: &[PredictedStar], conditions: [bool; 2]) -> SkyImage {
    let mut measured: Vec<Option<Place>> = stars.iter().map(|one| Some(Place::of_gaussian(&one.star))).collect();
    // A first image takes most of the Gaussians' error off the places; the last one, below, is judged by stars held out.
    if let Some(under_first_image) = measured_by_others(stars, &measured) {
        measured = under_first_image;
    }
    let (placed, place_sigma_px) = anchored(stars, &measured);
    let all: Vec<(usize, PsfStar)> = placed.into_iter().enumerate().filter_map(|(index, star)| Some((index, star?))).collect();
    let learnt_from: Vec<(usize, PsfStar)> = brightest(&all, |(_, star)| star, MAX_PIXELS).into_iter().cloned().collect();
    let chosen: Vec<&PsfStar> = learnt_from.iter().map(|(_, star)| star).collect();
    let (psf, report) = learn_with(&chosen, Terms { order: 0, by: conditions });
    SkyImage { psf, report, place_sigma_px, learnt_from }
}

/// The place of each star under an image of others, with the sky's places as these are now: under one of its own pixels it would scatter too little.
fn measured_by_others(stars: &[PredictedStar], measured: &[Option<Place>]) -> Option<Vec<Option<Place>>> {
    const PARTS: usize = 2;
    let (placed, _) = anchored(stars, measured);
    let mut next = vec![None; stars.len()];
    for part in 0..PARTS {
        let others: Vec<PsfStar> =
            placed.iter().enumerate().filter(|(i, _)| i % PARTS != part).filter_map(|(_, star)| star.clone()).collect();
        let image = fit_image(&brightest(&others, |star| star, MAX_PIXELS / PARTS), Terms::default(), None)?;
        for (place, one) in next.iter_mut().zip(stars).skip(part).step_by(PARTS) {
            *place = Place::under(&one.star, &image);
        }
    }
    Some(next)
}

/// A star's place by its own pixels.
#[derive(Clone, Copy)]
struct Place {
    at_px: [f64; 2],
    covariance_px2: [f64; 3],
}

impl Place {
    fn of_gaussian(star: &PsfStar) -> Self {
        Self { at_px: [star.model.x, star.model.y], covariance_px2: star.covariance_px2 }
    }

    fn under(star: &PsfStar, psf: &EmpiricalPsf) -> Option<Self> {
        let psf = psf.under(star.conditions);
        let mut profile = Profile::of(Some(&psf));
        let start = Model { empirical: true, ..star.model };
        let (model, offset) = star.photons.climb(&star.stamp, start, Freedom::Empirical, &mut profile)?;
        profile.draw(star.stamp.window, &model, false);
        let count = Freedom::Empirical.parameters();
        let own = inverse(&star.photons.normal(&star.stamp, &profile, model.flux_dn, offset, count).matrix, count)?;
        Some(Self { at_px: [model.x, model.y], covariance_px2: [own[2][2], own[3][2], own[3][3]] })
    }

    /// Mean variance along an axis.
    fn variance_px2(&self) -> f64 {
        f64::midpoint(self.covariance_px2[0], self.covariance_px2[2])
    }
}

/// The stars with the places that the sky says, and how well it says them. Stars that are not where they should be are left out.
fn anchored(stars: &[PredictedStar], measured: &[Option<Place>]) -> (Vec<Option<PsfStar>>, f64) {
    let mut frames: Vec<usize> = stars.iter().map(|one| one.frame).collect();
    frames.sort_unstable();
    frames.dedup();
    let mut off: Vec<Option<[f64; 2]>> = vec![None; stars.len()];
    for frame in frames {
        let own: Vec<usize> = (0..stars.len()).filter(|i| stars[*i].frame == frame && measured[*i].is_some()).collect();
        for (index, rest) in own.iter().zip(less_smooth(stars, measured, &own)) {
            off[*index] = rest;
        }
    }
    let sigma_px = scatter_px(measured, &off);
    let of = |((one, place), off): ((&PredictedStar, &Option<Place>), &Option<[f64; 2]>)| {
        let (place, off) = ((*place)?, (*off)?);
        let limit = MAX_OFF_SIGMA * (sigma_px * sigma_px + place.variance_px2()).sqrt();
        let sky = SkyPlace { at_px: [0, 1].map(|axis| place.at_px[axis] - off[axis]), sigma_px };
        (off[0].hypot(off[1]) < limit).then(|| PsfStar { sky: Some(sky), conditions: one.conditions, ..one.star.clone() })
    };
    (stars.iter().zip(measured).zip(&off).map(of).collect(), sigma_px)
}

/// Measured less predicted places of a frame's stars, less what is smooth over the frame.
fn less_smooth(stars: &[PredictedStar], measured: &[Option<Place>], own: &[usize]) -> Vec<Option<[f64; 2]>> {
    let places: Vec<(Place, [f64; 2])> = own.iter().filter_map(|i| Some((measured[*i]?, stars[*i].predicted_px))).collect();
    let Some((_, terms)) = MIN_STARS.into_iter().find(|(least, _)| places.len() >= *least) else { return vec![None; own.len()] };
    let size_px = stars[own[0]].star.size_px;
    let row = |at: [f64; 2]| -> [f64; 6] {
        let half = 0.5 * size_px[0].max(size_px[1]);
        let [x, y] = [0, 1].map(|axis| (at[axis] - 0.5 * (size_px[axis] - 1.0)) / half);
        [1.0, x, y, x * x, x * y, y * y]
    };
    let off = |(place, predicted): &(Place, [f64; 2]), axis: usize| place.at_px[axis] - predicted[axis];
    let along = |axis: usize| -> Option<Vec<f64>> {
        let mut rest: Vec<f64> = {
            let middle = median(&places.iter().map(|own| off(own, axis)).collect::<Vec<_>>())?;
            places.iter().map(|own| off(own, axis) - middle).collect()
        };
        for _ in 0..STEPS {
            let scatter = mad_sigma(&rest)?.max(1e-6);
            let (mut matrix, mut vector) = ([[0.0; 6]; 6], [0.0; 6]);
            for (own, rest) in places.iter().zip(&rest) {
                let (row, noise) = (row(own.1), scatter * scatter + own.0.variance_px2());
                let weight = (1.0 + rest * rest / (4.0 * noise)).powi(-2) / noise;
                for a in 0..terms {
                    vector[a] += weight * row[a] * off(own, axis);
                    for b in 0..=a {
                        matrix[a][b] += weight * row[a] * row[b];
                    }
                }
            }
            let smooth = solve(&matrix, &vector, terms, 0.0)?;
            for (rest, own) in rest.iter_mut().zip(&places) {
                let row = row(own.1);
                *rest = off(own, axis) - (0..terms).map(|a| row[a] * smooth[a]).sum::<f64>();
            }
        }
        Some(rest)
    };
    let (Some(x), Some(y)) = (along(0), along(1)) else { return vec![None; own.len()] };
    x.into_iter().zip(y).map(|(x, y)| Some([x, y])).collect()
}

/// Scatter of places about those that the sky says, beyond the pixels' noise, px per axis: by the half that the pixels place best.
fn scatter_px(measured: &[Option<Place>], off: &[Option<[f64; 2]>]) -> f64 {
    let mut told: Vec<(f64, [f64; 2])> =
        measured.iter().zip(off).filter_map(|(place, off)| Some((place.as_ref()?.variance_px2(), (*off)?))).collect();
    ascending(&mut told, |a| a.0);
    told.truncate(told.len().div_ceil(2));
    let both: Vec<f64> = told.iter().flat_map(|(_, off)| *off).collect();
    let noise = median(&told.iter().map(|(variance, _)| *variance).collect::<Vec<_>>()).unwrap_or(0.0);
    let scatter = mad_sigma(&both).unwrap_or(0.0);
    (scatter * scatter - noise).max(MIN_SIGMA_PX * MIN_SIGMA_PX).sqrt()
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_distr::{Distribution, Normal};
    use rand_pcg::Pcg64Mcg;

    use super::*;
    use crate::detect::image_model::paint_star;
    use crate::detect::measure::{Aids, detect_aided};
    use crate::detect::phase_bias::{BiasedStar, Estimator, PhaseBias, PixelNoise};
    use crate::detect::windowed::detect_windowed;
    use crate::detect::{DetectOptions, Detection};
    use crate::frame::Frame;

    const SIDE: usize = 384;
    const SKY_DN: f64 = 6.0;

    /// A frame of stars, and where they are: between faint and `range` times as bright, each drawn by `paint` at its place and with its flux.
    fn frame(seed: u64, range: f64, saturation_dn: f32, paint: impl Fn(&mut [f64], [f64; 2], f64)) -> (Frame, Vec<[f64; 2]>) {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let mut light = vec![0.0; SIDE * SIDE];
        let mut places = Vec::new();
        for cell in 0..100 {
            let at = [cell % 10, cell / 10].map(|k| 24.0 + 37.0 * f64::from(k) + rng.random_range(-3.0..3.0));
            let flux = 48_000.0 * range.powf(rng.random_range(-1.0..0.0));
            paint(&mut light, at, flux);
            places.push(at);
        }
        let pixels_dn = light
            .iter()
            .map(|value| {
                let noise = Normal::new(0.0, (SKY_DN * SKY_DN + value).sqrt()).unwrap();
                ((100.0 + value + noise.sample(&mut rng)) as f32).min(saturation_dn)
            })
            .collect();
        (Frame { width_px: SIDE, height_px: SIDE, pixels_dn, saturation_dn }, places)
    }

    /// A star with a core and a wide skirt, shares of the light with their σ, which no Gaussian is.
    fn skirted(parts: &[(f64, f64)]) -> impl Fn(&mut [f64], [f64; 2], f64) {
        |light, at, flux| paint_star(light, SIDE, at, flux, parts)
    }

    /// Frames, the stars found in each, and those that may tell the image.
    struct Night {
        frames: Vec<(Frame, Vec<[f64; 2]>)>,
        found: Vec<Vec<Detection>>,
        stars: Vec<PredictedStar>,
    }

    /// What the sky says of the frames lacks a shift and a tilt of each.
    fn night(frames: Vec<(Frame, Vec<[f64; 2]>)>) -> Night {
        let mut rng = Pcg64Mcg::seed_from_u64(99);
        let turbulence = Normal::new(0.0, 0.02).unwrap();
        let mut night = Night { frames, found: Vec::new(), stars: Vec::new() };
        for (index, (frame, places)) in night.frames.iter().enumerate() {
            let (found, own) = detect_aided(frame, &options(), &Aids { keep: 100, ..Aids::default() }).unwrap();
            for star in own {
                let at = places.iter().find(|at| (at[0] - star.model.x).hypot(at[1] - star.model.y) < 1.0).unwrap();
                let predicted = at.map(|along| along + 0.3 * index as f64 + 1e-3 * at[0] + turbulence.sample(&mut rng));
                night.stars.push(PredictedStar { star, frame: index, predicted_px: predicted, conditions: [0.0; 2] });
            }
            night.found.push(found.stars);
        }
        night
    }

    fn options() -> DetectOptions {
        DetectOptions { gain_e_per_dn: Some(1.0), ..DetectOptions::default() }
    }

    fn asked(stars: &[Vec<Detection>]) -> Vec<BiasedStar> {
        let of = |star: &Detection| BiasedStar { at_px: [star.x_px, star.y_px], flux_dn: star.flux_dn, conditions: [0.0; 2] };
        stars.iter().flatten().map(of).collect()
    }

    /// Amplitude of the sine of the phase in errors along an axis, px.
    fn s_curve(errors: &[(f64, f64)]) -> f64 {
        let of = |(phase, error): &(f64, f64)| 2.0 * error * (std::f64::consts::TAU * phase).sin();
        errors.iter().map(of).sum::<f64>() / errors.len() as f64
    }

    /// Errors along x of the stars found, before and after the bias is taken off, each with the phase.
    fn errors(stars: &[Detection], places: &[[f64; 2]], bias: Option<&PhaseBias>) -> Vec<(f64, f64)> {
        let of = |star: &Detection| {
            let at = places.iter().find(|at| (at[0] - star.x_px).hypot(at[1] - star.y_px) < 1.0)?;
            let asked = BiasedStar { at_px: [star.x_px, star.y_px], flux_dn: star.flux_dn, conditions: [0.0; 2] };
            let off = bias.map_or(0.0, |bias| bias.at(&asked)[0]);
            Some((at[0] - at[0].round(), star.x_px - off - at[0]))
        };
        stars.iter().filter_map(of).collect()
    }

    /// Amplitudes of the errors that follow the phase, before and after, of stars found in frames.
    fn both_s_curves(frames: &[(Frame, Vec<[f64; 2]>)], found: &[Vec<Detection>], bias: &PhaseBias) -> [f64; 2] {
        [None, Some(bias)].map(|bias| {
            let all: Vec<_> = found.iter().zip(frames).flat_map(|(stars, (_, places))| errors(stars, places, bias)).collect();
            s_curve(&all)
        })
    }

    #[test]
    fn places_follow_no_phase_once_the_image_is_learnt_from_the_sky() {
        let all = (0..4).map(|seed| frame(seed, 12.0, f32::INFINITY, skirted(&[(0.6, 0.3), (0.4, 0.8)]))).collect();
        let Night { frames, found: gaussian, stars } = night(all);
        let windowed: Vec<_> = frames.iter().map(|(frame, _)| detect_windowed(frame, &options(), None).unwrap().stars).collect();
        let image = learn_from_sky(&stars, [false; 2]);
        assert!((image.place_sigma_px - 0.02).abs() < 0.008, "{image:?}");
        let psf = image.psf.unwrap();
        let noise = PixelNoise { sky_dn2: SKY_DN * SKY_DN, per_dn: 1.0, full_dn: f64::INFINITY };
        let width = median(&windowed.iter().flatten().map(|star| star.width_px).collect::<Vec<_>>()).unwrap();
        for (name, estimator, found) in [("gaussian", Estimator::Gaussian, &gaussian), ("windowed", Estimator::Windowed(width), &windowed)]
        {
            let bias = PhaseBias::predict(&psf, estimator, noise, &asked(found)).unwrap();
            let [before, after] = both_s_curves(&frames, found, &bias);
            assert!(before.abs() > 0.02, "{name}: {before}");
            // The sky's places of the stars that the image is learnt from leave √(2/n)·σ in an amplitude. Beside it
            // a twentieth of the bias may be predicted wrongly: the rest of the windowed estimator's does not fall with the number of stars.
            let left = (2.0 / image.report.stars as f64).sqrt() * image.place_sigma_px;
            assert!(after.abs() < 3.5 * left + 0.05 * before.abs(), "{name}: {before} {after}, left {left}");
        }
    }

    #[test]
    fn places_of_stars_with_full_pixels_follow_no_phase_either() {
        const FULL_DN: f32 = 8000.0;
        let Night { frames, found, stars } =
            night((0..12).map(|seed| frame(seed, 12.0, FULL_DN, skirted(&[(0.7, 0.5), (0.3, 1.1)]))).collect());
        let psf = learn_from_sky(&stars, [false; 2]).psf.unwrap();
        let full: Vec<Vec<Detection>> =
            found.iter().map(|stars| stars.iter().filter(|star| star.flags.saturated).cloned().collect()).collect();
        assert!(full.iter().flatten().count() > 60, "{}", full.iter().flatten().count());
        let of = |full_dn: f64| {
            let noise = PixelNoise { sky_dn2: SKY_DN * SKY_DN, per_dn: 1.0, full_dn };
            both_s_curves(&frames, &full, &PhaseBias::predict(&psf, Estimator::Gaussian, noise, &asked(&found)).unwrap())
        };
        let ([before, after], [_, as_if_none]) = (of(f64::from(FULL_DN) - 100.0), of(f64::INFINITY));
        // What is left does not fall with the number of stars: the fit of so few pixels is foreseen to a half.
        assert!(before.abs() > 0.01 && after.abs() < 0.5 * before.abs(), "{before} {after}");
        assert!(as_if_none.abs() > 2.0 * after.abs(), "as if no pixel were full: {as_if_none}, {after}");
    }

    /// Lopsided stars: a bright one is found otherwise than a faint one, and no longer once the image is learnt.
    #[test]
    fn places_follow_no_brightness_once_the_image_is_learnt_from_the_sky() {
        let lopsided = |light: &mut [f64], at: [f64; 2], flux: f64| {
            paint_star(light, SIDE, at, 0.75 * flux, &[(1.0, 0.7)]);
            paint_star(light, SIDE, [at[0] + 1.2, at[1]], 0.25 * flux, &[(1.0, 0.9)]);
        };
        let Night { frames, found, stars } = night((0..6).map(|seed| frame(seed, 60.0, f32::INFINITY, lopsided)).collect());
        let psf = learn_from_sky(&stars, [false; 2]).psf.unwrap();
        let noise = PixelNoise { sky_dn2: SKY_DN * SKY_DN, per_dn: 1.0, full_dn: f64::INFINITY };
        let bias = PhaseBias::predict(&psf, Estimator::Gaussian, noise, &asked(&found)).unwrap();
        // By how much stars of over 20,000 DN are found farther to the right than those below 2000 DN, px.
        let step = |bias: Option<&PhaseBias>| {
            let mean = |is_asked: fn(f64) -> bool| {
                let own = found.iter().zip(&frames).flat_map(|(stars, (_, places))| {
                    let asked: Vec<Detection> = stars.iter().filter(|star| is_asked(star.flux_dn)).cloned().collect();
                    errors(&asked, places, bias)
                });
                let all: Vec<f64> = own.map(|(_, error)| error).collect();
                all.iter().sum::<f64>() / all.len() as f64
            };
            mean(|flux_dn| flux_dn > 20_000.0) - mean(|flux_dn| flux_dn < 2000.0)
        };
        let [before, after] = [None, Some(&bias)].map(step);
        assert!(before > 0.03 && after.abs() < 0.2 * before, "{before} {after}");
    }
}
