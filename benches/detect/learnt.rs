//! The image of a star learnt from the stars themselves: how near the bound it takes them, the same all over the frame or not.

use boresight::detect::{Aids, DetectOptions, Detections, EmpiricalPsf, PsfReport, PsfStar, detect_aided, learn};
use rayon::prelude::*;

use super::drawn::{Image, Star, electrons_for};
use super::study::{BACKGROUND_E, DETECTOR, Frames, PITCH_PX, SIDE_PX, Score, known, nearest, places, scored, sky_of};

/// Clean stars that a frame gives for learning, at most.
pub(crate) const KEPT: usize = 300;
/// Powers of x and y of the smooth field that is taken out where the image changes over the frame.
const SMOOTH_ORDER: i32 = 5;

fn options() -> DetectOptions {
    DetectOptions { psf_sigma_px: None, ..known(1.0) }
}

/// Stars whose image is learnt from themselves: under Gaussians, and under what was learnt.
pub(crate) fn learnt(image: &Image, snr: f64, frames: Frames) -> (Score, Option<Score>, PsfReport) {
    let drawn = Drawn::new(|_| image.clone(), snr, frames);
    let sum = |scores: Vec<Score>| scores.iter().fold(Score::default(), Score::add).centred();
    let (gaussian, psf, report) = drawn.gaussian_and_learnt(scored);
    (sum(gaussian), psf.as_ref().map(|psf| sum(drawn.under(psf, scored))), report)
}

/// Frames of stars whose image is a function of the place.
struct Drawn<F> {
    image_at: F,
    electrons: f64,
    frames: Frames,
}

impl<F: Fn([f64; 2]) -> Image + Sync> Drawn<F> {
    /// The ratio of signal to noise is that in the middle of the frame.
    fn new(image_at: F, snr: f64, frames: Frames) -> Self {
        let electrons = electrons_for(snr, &image_at([0.5 * frames.side_px as f64; 2]), BACKGROUND_E, &DETECTOR);
        Self { image_at, electrons, frames }
    }

    /// What `tell` says of a frame's stars and of what was found in it, and the stars to learn from.
    fn look<T>(&self, k: usize, aids: &Aids<'_>, tell: impl Fn(&[Star<'_>], &Detections) -> T) -> (T, Vec<PsfStar>) {
        let (mut rng, side_px) = (self.frames.rng(k), self.frames.side_px);
        let places = places(side_px, &mut rng);
        let images: Vec<Image> = places.iter().map(|place| (self.image_at)(*place)).collect();
        let star = |([x, y], image): ([f64; 2], _)| Star { x, y, electrons: self.electrons, image };
        let stars: Vec<Star<'_>> = places.into_iter().zip(&images).map(star).collect();
        let frame = sky_of(&stars, side_px).expose(&DETECTOR, &mut rng);
        let (found, kept) = detect_aided(&frame, &options(), aids).expect("a frame that can be measured");
        (tell(&stars, &found), kept)
    }

    /// What is told under Gaussians, and what the stars say of their image.
    fn gaussian_and_learnt<T: Send>(
        &self,
        tell: impl Fn(&[Star<'_>], &Detections) -> T + Sync,
    ) -> (Vec<T>, Option<EmpiricalPsf>, PsfReport) {
        let aids = Aids { keep: KEPT, ..Aids::default() };
        let looks = (0..self.frames.count).into_par_iter().map(|k| self.look(k, &aids, &tell));
        let (told, kept): (Vec<T>, Vec<_>) = looks.collect::<Vec<_>>().into_iter().unzip();
        let (psf, report) = learn(&kept.concat());
        (told, psf, report)
    }

    fn under<T: Send>(&self, psf: &EmpiricalPsf, tell: impl Fn(&[Star<'_>], &Detections) -> T + Sync) -> Vec<T> {
        let aids = Aids { psf: Some(psf), ..Aids::default() };
        (0..self.frames.count).into_par_iter().map(|k| self.look(k, &aids, &tell).0).collect()
    }
}

/// One measured star: where, its errors in x and y, their stated variances, and those of the bound.
#[derive(Clone, Copy)]
pub(crate) struct Error {
    pub(crate) at_px: [f64; 2],
    pub(crate) aside_px: [f64; 2],
    pub(crate) stated_px2: [f64; 2],
    pub(crate) bound_px2: [f64; 2],
}

/// Errors less a smooth field: where in an image that changes over the frame a star lies is a matter of definition at every place, and what a
/// camera's distortion takes up. 2-D error over the bound, and variance of the pulls.
pub(crate) fn beside_smooth(errors: &[Error], side_px: usize) -> (f64, f64) {
    let terms: Vec<[i32; 2]> = (0..=SMOOTH_ORDER).flat_map(|n| (0..=n).map(move |k| [n - k, k])).collect();
    let row = |e: &Error| {
        let [x, y] = e.at_px.map(|at| 2.0 * at / side_px as f64 - 1.0);
        terms.iter().map(move |[a, b]| x.powi(*a) * y.powi(*b)).collect::<Vec<f64>>()
    };
    let matrix = nalgebra::DMatrix::from_fn(errors.len(), terms.len(), |i, k| row(&errors[i])[k]);
    let normal = (matrix.transpose() * &matrix).cholesky().expect("stars all over the frame");
    let (mut error2, mut bound2, mut pull2) = (0.0, 0.0, 0.0);
    for axis in 0..2 {
        let right = nalgebra::DVector::from_fn(errors.len(), |i, _| errors[i].aside_px[axis]);
        let left = &right - &matrix * normal.solve(&(matrix.transpose() * &right));
        for (e, left) in errors.iter().zip(left.iter()) {
            error2 += left * left;
            bound2 += e.bound_px2[axis];
            pull2 += left * left / e.stated_px2[axis];
        }
    }
    // the terms of the field have taken up some
    let freedom = 1.0 - terms.len() as f64 / errors.len() as f64;
    ((error2 / bound2 / freedom).sqrt(), pull2 / (2.0 * errors.len() as f64 * freedom))
}

fn errors(stars: &[Star<'_>], found: &Detections) -> Vec<Error> {
    let of = |star: &Star<'_>| {
        let d = nearest(found, star.x, star.y)?;
        Some(Error {
            at_px: [star.x, star.y],
            aside_px: [d.x_px - star.x, d.y_px - star.y],
            stated_px2: [d.covariance_px2[0], d.covariance_px2[2]],
            bound_px2: star.bound(BACKGROUND_E, &DETECTOR, false).0,
        })
    };
    stars.iter().filter_map(of).collect()
}

/// An image whose flare grows from the middle of the frame outwards, as coma does.
fn growing(core_px: f64) -> impl Fn([f64; 2]) -> Image + Sync {
    move |at_px| {
        let [x, y] = at_px.map(|at| 2.0 * at / SIDE_PX as f64 - 1.0);
        Image::comatic(core_px, y.atan2(x)).with_flare(x.hypot(y))
    }
}

pub(crate) fn tables(frames: usize, line: &mut impl FnMut(&str)) {
    let stars = frames * (SIDE_PX / PITCH_PX).pow(2);
    line(&format!(
        "\nAn image with a flare and wings, of which nothing is known; {stars} stars a point, of which the best tell the image. Errors from their mean."
    ));
    line(
        "core/px  SNR   Gaussians: error/bound, bias/px   learnt: error/bound, pull var, bias/px   χ²/dof held out: Gaussians, learnt; stars",
    );
    let tail =
        |report: &PsfReport| format!("{:.3} {:.3} {}", report.gaussian_deviance_per_dof, report.empirical_deviance_per_dof, report.stars);
    for (i, core) in [0.6, 0.9, 1.4].into_iter().enumerate() {
        for (k, snr) in [20.0, 30.0, 100.0, 300.0, 1000.0].into_iter().enumerate() {
            let (gaussian, learnt, report) =
                learnt(&Image::comatic(core, 0.6), snr, Frames { count: frames, side_px: SIDE_PX, seed: 500 + (10 * i + k) as u64 });
            let own = learnt
                .as_ref()
                .map_or_else(|| "Gaussians stay".to_owned(), |s| format!("{:7.4} {:7.4} {:9.5}", s.over_bound(), s.pull2(), s.bias_px()));
            line(&format!(
                "{core:4.1} {snr:6.0}    {:7.4} {:9.5}    {own}    {}",
                gaussian.over_bound(),
                gaussian.bias_px(),
                tail(&report)
            ));
        }
    }
    line(&format!(
        "\nThe same where the flare grows from nothing at the middle of the frame outwards. Errors less a smooth field of order {SMOOTH_ORDER}: where in such an image\n\
         a star lies is a matter of definition, which a camera's distortion takes up."
    ));
    line(
        "core/px  SNR   Gaussians: error/bound, pull var   learnt: error/bound, pull var, order   χ²/dof held out: Gaussians, learnt; stars",
    );
    for (i, core) in [0.6, 0.9, 1.4].into_iter().enumerate() {
        for (k, snr) in [30.0, 100.0, 300.0].into_iter().enumerate() {
            let drawn = Drawn::new(growing(core), snr, Frames { count: frames, side_px: SIDE_PX, seed: 600 + (10 * i + k) as u64 });
            let (gaussian, psf, report) = drawn.gaussian_and_learnt(errors);
            let (error, pull2) = beside_smooth(&gaussian.concat(), SIDE_PX);
            let own = psf.as_ref().map_or_else(
                || "Gaussians stay".to_owned(),
                |psf| {
                    let (error, pull2) = beside_smooth(&drawn.under(psf, errors).concat(), SIDE_PX);
                    format!("{error:7.4} {pull2:7.4} {}", report.field_order)
                },
            );
            line(&format!("{core:4.1} {snr:6.0}    {error:7.4} {pull2:9.4}    {own}    {}", tail(&report)));
        }
    }
}
