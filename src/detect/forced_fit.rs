//! Forced fit under a known background: for images rendered without noise, whose background and noise cannot be measured.

use super::background::Background;
use super::fit::{Freedom, SNR_FOR_WIDTH};
use super::image_model::{Model, Shape, radius_px};
use super::stamp::Scene;
use super::work::Work;
use crate::frame::Frame;

/// What is known of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FixedBackground {
    /// Level of the sky, DN.
    pub background_dn: f64,
    /// Noise that a pixel of the sky would have, DN.
    pub noise_dn: f64,
    /// Electrons per count.
    pub gain_e_per_dn: f64,
    /// Width (Gaussian σ before the pixel integrates it) of the frame's typical star.
    pub psf_sigma_px: f64,
}

/// A star as fitted under a known sky.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ForcedFit {
    /// Column of the centre.
    pub x_px: f64,
    /// Row of the centre.
    pub y_px: f64,
    /// Flux above the background, DN.
    pub flux_dn: f64,
    /// Width (Gaussian σ); that of the typical star where the star is too faint to tell its own.
    pub width_px: f64,
}

/// Fits stars near these places (column, row) as [`super::detect`] does where images are round: the width of bright stars is free, that of faint
/// ones the typical. Where the width cannot be found, it stays the typical one; `None` where that fit fails too or leaves its place.
#[must_use]
pub fn fit_forced(frame: &Frame, places_px: &[[f64; 2]], known: &FixedBackground) -> Vec<Option<ForcedFit>> {
    let background = Background::even(frame, known.background_dn, known.noise_dn);
    let masked = vec![false; frame.pixels_dn.len()];
    let work = Work::unlimited();
    let scene = Scene {
        frame,
        background: &background,
        masked: &masked,
        variance_per_dn: 1.0 / known.gain_e_per_dn,
        noise_floor_dn: known.noise_dn,
        psf: None,
        work: &work,
    };
    let shape = Shape::round(known.psf_sigma_px);
    let fit = |[x, y]: &[f64; 2]| {
        // The flux is found before the first step, whatever it begins with.
        let start = Model { x: *x, y: *y, flux_dn: 1.0, shape, radius: radius_px(shape), empirical: false };
        let of_known_width = scene.fit(start, Freedom::Fixed, &[])?;
        let is_bright = of_known_width.model.flux_dn > SNR_FOR_WIDTH * of_known_width.flux_sigma_dn;
        // A width that runs away takes the star with it: then the typical one must do, as in the measurement of a frame.
        let own = if is_bright { scene.fit(of_known_width.model, Freedom::Width, &[]) } else { None };
        let model = own.unwrap_or(of_known_width).model;
        Some(ForcedFit { x_px: model.x, y_px: model.y, flux_dn: model.flux_dn, width_px: model.shape.sigma_px() })
    };
    places_px.iter().map(fit).collect()
}
