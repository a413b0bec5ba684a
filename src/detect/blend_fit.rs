//! Simultaneous fit of two blended stars: positions and fluxes of both, one background, and one width factor for both.
//!
//! Fitting them in turns, each with the other subtracted, reaches the same positions but states errors as if the other star were known. The width
//! is a factor on the frame's ePSF or Gaussian, with a prior from the stars near by: at short distance two stars further apart and two wider images
//! are nearly the same pixels. Same likelihood and steps as for one star (`fit`).

use super::fit::{Fit, Freedom, ROUNDING, RULES, WORTH, settled};
use super::image_model::{Model, Shape};
use super::psf::Profile;
use super::stamp::{MAX_DROPS, Photons, Scene, Stamp};
use crate::statistics::cholesky::{inverse, solve};
use crate::statistics::levenberg_marquardt::{Attempt, LeastSquares, minimise};

/// What a pixel costs to be weighed for two beyond what it costs for one and one, nanoseconds.
const WEIGHED_NS: u64 = 80;
/// Background; flux, x and y of each; ln of the breadth.
const UNKNOWNS: usize = 8;

/// How broad the images of stars are about here: ln of the factor on the typical width, and its scatter, 0 where it is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct WidthFactor {
    pub(super) ln: f64,
    pub(super) sigma: f64,
}

impl WidthFactor {
    pub(super) const KNOWN: Self = Self { ln: 0.0, sigma: 0.0 };

    fn unknowns(self) -> usize {
        if self.sigma > 0.0 { UNKNOWNS } else { UNKNOWNS - 1 }
    }

    /// The empirical image is as broad as it is.
    fn of_image(self, model: &Model) -> Self {
        if model.empirical { Self::KNOWN } else { self }
    }

    /// The typical shape as broad as it is here.
    pub(super) fn of(self, typical: Shape) -> Shape {
        typical.scaled(self.ln.exp())
    }
}

/// Two stars as modelled.
#[derive(Clone, Copy, Debug)]
pub(super) struct BlendFit {
    pub(super) models: [Model; 2],
    pub(super) offset_dn: f64,
    /// ln of the breadth over that of the typical image.
    ln_breadth: f64,
}

struct Normal {
    matrix: [[f64; UNKNOWNS]; UNKNOWNS],
    vector: [f64; UNKNOWNS],
    chi2: f64,
}

impl Normal {
    const ZERO: Self = Self { matrix: [[0.0; UNKNOWNS]; UNKNOWNS], vector: [0.0; UNKNOWNS], chi2: 0.0 };
}

/// The images of both in the pixels.
struct Images<'a>([Profile<'a>; 2]);

impl Images<'_> {
    fn draw(&mut self, stamp: &Stamp, duet: &BlendFit) {
        for (profile, model) in self.0.iter_mut().zip(&duet.models) {
            profile.draw(stamp.window, model, false);
        }
        self.0[0].spend(WEIGHED_NS * stamp.data.len() as u64);
    }

    fn light_dn(&self, duet: &BlendFit, i: usize) -> f64 {
        duet.models.iter().zip(&self.0).map(|(model, profile)| model.flux_dn * profile.value[i]).sum()
    }
}

impl Scene<'_> {
    /// The pixels of two stars, the light of others taken off.
    pub(super) fn stamp_of_two(&self, models: &[Model; 2], neighbours: &[Model]) -> Stamp {
        let [a, b] = models;
        let apart_px = (a.x - b.x).abs().max((a.y - b.y).abs());
        let radius = a.radius.max(b.radius) + (0.5 * apart_px).ceil() as usize;
        let middle = Model { x: f64::midpoint(a.x, b.x), y: f64::midpoint(a.y, b.y), radius, ..*a };
        self.stamp(middle, neighbours, &mut self.profile())
    }

    /// Fits two stars together; `None` where there are no two. `typical`: the image whose breadth they have.
    pub(super) fn fit_two(&self, starts: [Model; 2], typical: Shape, breadth: WidthFactor, neighbours: &[Model]) -> Option<[Fit; 2]> {
        let mut stamp = self.stamp_of_two(&starts, neighbours);
        let duet = self.settle_two(&mut stamp, starts, typical, breadth)?;
        self.finish_two(&stamp, &duet, typical, breadth)
    }

    /// The best two stars in the pixels, those far off them left out.
    pub(super) fn settle_two(&self, stamp: &mut Stamp, starts: [Model; 2], typical: Shape, breadth: WidthFactor) -> Option<BlendFit> {
        let breadth = breadth.of_image(&starts[0]);
        let mut images = Images([self.profile(), self.profile()]);
        let climb = |stamp: &Stamp, models, images: &mut Images<'_>| self.photons().fit_blend(stamp, models, typical, breadth, images);
        let mut duet = climb(stamp, starts, &mut images)?;
        for _ in 0..MAX_DROPS {
            images.draw(stamp, &duet);
            if !self.photons().drop_far(stamp, |i| images.light_dn(&duet, i), duet.offset_dn) {
                break;
            }
            duet = climb(stamp, duet.models, &mut images)?;
        }
        Some(duet)
    }

    /// What is to be known of both: errors are those of the joint fit.
    pub(super) fn finish_two(&self, stamp: &Stamp, duet: &BlendFit, typical: Shape, breadth: WidthFactor) -> Option<[Fit; 2]> {
        let breadth = breadth.of_image(&duet.models[0]);
        let mut images = Images([self.profile(), self.profile()]);
        images.draw(stamp, duet);
        let count = breadth.unknowns();
        let normal = self.photons().normal_two(stamp, &images, duet, typical, breadth);
        let covariance = inverse(&normal.matrix, count)?;
        let used = stamp.used.iter().filter(|u| **u).count();
        let fit = |k: usize| -> Option<Fit> {
            let (model, at) = (duet.models[k], 1 + 3 * k);
            let flux_sigma_dn = covariance[at][at].sqrt();
            if !(model.flux_dn > 0.0 && flux_sigma_dn.is_finite()) {
                return None;
            }
            let other = (duet.models[1 - k], &images.0[1 - k]);
            let own = self.photons().without(stamp, other);
            let (gradient, lone_pixel_excess) = self.leftovers(&own, &images.0[k], model, duet.offset_dn);
            let mesh = self.background.slope_dn(inside(model.x, self.frame.width_px), inside(model.y, self.frame.height_px));
            Some(Fit {
                model,
                offset_dn: duet.offset_dn,
                covariance_px2: [covariance[at + 1][at + 1], covariance[at + 2][at + 1], covariance[at + 2][at + 2]],
                flux_sigma_dn,
                chi2: normal.chi2,
                dof: used.saturating_sub(count).max(1),
                peak_dn: stamp.peak_dn,
                gradient_dn: [gradient[0] + mesh[0], gradient[1] + mesh[1]],
                edge: stamp.edge,
                lone_pixel_excess,
                freedom: if model.empirical { Freedom::Empirical } else { Freedom::Fixed },
            })
        };
        Some([fit(0)?, fit(1)?])
    }
}

fn inside(v: f64, n: usize) -> usize {
    (v.round().max(0.0) as usize).min(n - 1)
}

impl Photons {
    /// Pixels with a star's light taken off.
    fn without(self, stamp: &Stamp, (model, profile): (Model, &Profile<'_>)) -> Stamp {
        let mut own = stamp.clone();
        for ((data, variance), share) in own.data.iter_mut().zip(&mut own.variance).zip(&profile.value) {
            let light = (model.flux_dn * share).max(0.0);
            *data -= light;
            *variance += light * self.variance_per_dn;
        }
        own
    }

    fn normal_two(self, stamp: &Stamp, images: &Images<'_>, duet: &BlendFit, typical: Shape, breadth: WidthFactor) -> Normal {
        let mut n = Normal::ZERO;
        let shape = duet.models[0].shape;
        let count = breadth.unknowns();
        let round = typical.is_round();
        for i in (0..stamp.data.len()).filter(|i| stamp.used[*i]) {
            let mut row = [1.0; UNKNOWNS];
            let (mut light, mut wider) = (0.0, 0.0);
            for (k, (model, profile)) in duet.models.iter().zip(&images.0).enumerate() {
                let (flux, d) = (model.flux_dn, &profile.derivatives[i]);
                light += flux * profile.value[i];
                row[1 + 3 * k..4 + 3 * k].copy_from_slice(&[profile.value[i], flux * d[0], flux * d[1]]);
                let by_ln = if round { shape.sigma_px() * d[2] } else { 2.0 * (shape.xx * d[2] + shape.xy * d[3] + shape.yy * d[4]) };
                wider += flux * by_ln;
            }
            row[UNKNOWNS - 1] = wider;
            let weight = 1.0 / (stamp.variance[i] + light.max(0.0) * self.variance_per_dn);
            let residual = stamp.data[i] - light - duet.offset_dn;
            n.chi2 += weight * residual * residual;
            for a in 0..count {
                let weighted = weight * row[a];
                n.vector[a] += weighted * residual;
                for (cell, r) in n.matrix[a][..=a].iter_mut().zip(&row) {
                    *cell += weighted * r;
                }
            }
        }
        if count == UNKNOWNS {
            let (off, weight) = (duet.ln_breadth - breadth.ln, breadth.sigma.powi(-2));
            n.chi2 += weight * off * off;
            n.vector[UNKNOWNS - 1] -= weight * off;
            n.matrix[UNKNOWNS - 1][UNKNOWNS - 1] += weight;
        }
        n
    }

    /// χ² of the pixels alone.
    pub(super) fn chi2_of_two(self, stamp: &Stamp, duet: &BlendFit, psf: Option<&super::EmpiricalPsf>) -> f64 {
        let mut images = Images([Profile::of(psf), Profile::of(psf)]);
        images.draw(stamp, duet);
        let of = |i: usize| {
            let light = images.light_dn(duet, i);
            (stamp.data[i] - light - duet.offset_dn).powi(2) / (stamp.variance[i] + light.max(0.0) * self.variance_per_dn)
        };
        (0..stamp.data.len()).filter(|i| stamp.used[*i]).map(of).sum()
    }

    fn fit_blend(
        self,
        stamp: &Stamp,
        starts: [Model; 2],
        typical: Shape,
        breadth: WidthFactor,
        images: &mut Images<'_>,
    ) -> Option<BlendFit> {
        let count = breadth.unknowns();
        let used = stamp.used.iter().filter(|u| **u).count();
        if used < count + 2 {
            return None;
        }
        let shape = breadth.of(typical);
        let reach = (1.5 + shape.axes_px().0).max(starts[0].radius as f64 / 4.0);
        let mut duet = BlendFit { models: starts.map(|m| Model { shape, ..m }), offset_dn: 0.0, ln_breadth: breadth.ln };
        images.draw(stamp, &duet);
        self.linear_two(stamp, images, &mut duet)?;
        let mut climb = Climb {
            photons: self,
            stamp,
            starts,
            typical,
            breadth,
            reach,
            dof: (used - count) as f64,
            duet,
            trial_images: Images([images.0[0].like(), images.0[1].like()]),
            images,
            weights: vec![0.0; stamp.data.len()],
            normal: Normal::ZERO,
            misfit: 1.0,
            left: f64::INFINITY,
        };
        settled(minimise(&mut climb, &RULES), climb.left).then_some(climb.duet)
    }

    /// Best background and fluxes at given places.
    fn linear_two(self, stamp: &Stamp, images: &Images<'_>, duet: &mut BlendFit) -> Option<()> {
        for _ in 0..2 {
            let (mut matrix, mut vector) = ([[0.0; 3]; 3], [0.0; 3]);
            for i in (0..stamp.data.len()).filter(|i| stamp.used[*i]) {
                let light = images.light_dn(duet, i);
                let weight = 1.0 / (stamp.variance[i] + light.max(0.0) * self.variance_per_dn);
                let residual = stamp.data[i] - light - duet.offset_dn;
                let row = [1.0, images.0[0].value[i], images.0[1].value[i]];
                for a in 0..3 {
                    vector[a] += weight * row[a] * residual;
                    for b in 0..=a {
                        matrix[a][b] += weight * row[a] * row[b];
                    }
                }
            }
            let step = solve(&matrix, &vector, 3, 0.0)?;
            duet.offset_dn += step[0];
            duet.models[0].flux_dn += step[1];
            duet.models[1].flux_dn += step[2];
        }
        // where one of them takes it all the steps may still part them
        let total = (duet.models[0].flux_dn + duet.models[1].flux_dn).max(0.0);
        for model in &mut duet.models {
            model.flux_dn = model.flux_dn.max(0.02 * total);
        }
        (total > 0.0).then_some(())
    }
}

/// The fit of two stars on its way.
struct Climb<'c, 'p> {
    photons: Photons,
    stamp: &'c Stamp,
    starts: [Model; 2],
    typical: Shape,
    breadth: WidthFactor,
    /// How far each may go from its start along each axis, px.
    reach: f64,
    dof: f64,
    duet: BlendFit,
    /// The images as they are, and as a step would have them.
    images: &'c mut Images<'p>,
    trial_images: Images<'p>,
    weights: Vec<f64>,
    normal: Normal,
    misfit: f64,
    /// What the last step was worth.
    left: f64,
}

impl LeastSquares for Climb<'_, '_> {
    type Step = [f64; UNKNOWNS];

    fn linearise(&mut self) {
        let (stamp, photons) = (self.stamp, self.photons);
        self.normal = photons.normal_two(stamp, self.images, &self.duet, self.typical, self.breadth);
        self.misfit = (self.normal.chi2 / self.dof).max(1.0);
        for (i, w) in self.weights.iter_mut().enumerate() {
            *w = 1.0 / (stamp.variance[i] + self.images.light_dn(&self.duet, i).max(0.0) * photons.variance_per_dn);
        }
    }

    fn step(&self, damping: f64) -> Option<Self::Step> {
        solve(&self.normal.matrix, &self.normal.vector, self.breadth.unknowns(), damping)
    }

    fn attempt(&mut self, step: &Self::Step) -> Attempt {
        let (stamp, breadth, reach, count) = (self.stamp, self.breadth, self.reach, self.breadth.unknowns());
        let next = self.duet.advanced(step, self.typical, count);
        let near = next.models.iter().zip(&self.starts).all(|(m, s)| (m.x - s.x).abs() <= reach && (m.y - s.y).abs() <= reach);
        let valid = near && next.models.iter().all(|m| m.flux_dn > 0.0) && (next.ln_breadth - breadth.ln).abs() < 0.5;
        if valid {
            self.trial_images.draw(stamp, &next);
        }
        let gain: f64 = step.iter().zip(&self.normal.vector).map(|(s, v)| s * v).sum();
        let trial = || {
            let of = |i: usize| self.weights[i] * (stamp.data[i] - self.trial_images.light_dn(&next, i) - next.offset_dn).powi(2);
            let held = if count == UNKNOWNS { ((next.ln_breadth - breadth.ln) / breadth.sigma).powi(2) } else { 0.0 };
            (0..stamp.data.len()).filter(|i| stamp.used[*i]).map(of).sum::<f64>() + held
        };
        let is_better = valid && trial() <= self.normal.chi2 * (1.0 + ROUNDING);
        if is_better {
            std::mem::swap(self.images, &mut self.trial_images);
            self.duet = next;
            self.left = gain / self.misfit;
        }
        Attempt { is_better, is_last: gain < WORTH * self.misfit }
    }
}

impl BlendFit {
    fn advanced(&self, step: &[f64; UNKNOWNS], typical: Shape, count: usize) -> Self {
        let ln_breadth = if count == UNKNOWNS { self.ln_breadth + step[UNKNOWNS - 1] } else { self.ln_breadth };
        let shape = typical.scaled(ln_breadth.exp());
        let mut models = self.models;
        for (model, step) in models.iter_mut().zip(step[1..7].chunks_exact(3)) {
            *model = Model { flux_dn: model.flux_dn + step[0], x: model.x + step[1], y: model.y + step[2], shape, ..*model };
        }
        Self { models, offset_dn: self.offset_dn + step[0], ln_breadth }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detect::background::Background;
    use crate::detect::image_model::Window;
    use crate::frame::Frame;

    /// Two stars drawn as they are modelled come back, whatever the shape, with a breadth that is not the typical one.
    #[test]
    fn two_that_were_drawn_come_back() {
        for (typical, broader) in [(Shape::round(1.1), 1.0_f64), (Shape::round(0.8), 1.06), (Shape::ellipse(2.0, 0.4, 1.2), 1.05)] {
            let (width, shape) = (41, typical.scaled(broader));
            let model = |x: f64, y: f64, flux_dn: f64| Model { x, y, flux_dn, shape, radius: 8, empirical: false };
            let truth = [model(19.3, 20.1, 9000.0), model(21.4, 21.0, 4000.0)];
            let mut profile = Profile::new();
            let mut pixels_dn = vec![100.0_f32; width * width];
            for star in &truth {
                profile.draw(Window { x0: 0, y0: 0, columns: width, rows: width }, star, false);
                for (pixel, share) in pixels_dn.iter_mut().zip(&profile.value) {
                    *pixel += (star.flux_dn * share) as f32;
                }
            }
            let frame = Frame { width_px: width, height_px: width, pixels_dn, saturation_dn: f32::MAX };
            let background = Background::even(&frame, 100.0, 2.0);
            let masked = vec![false; width * width];
            let work = crate::detect::work::Work::unlimited();
            let scene = Scene {
                frame: &frame,
                background: &background,
                masked: &masked,
                variance_per_dn: 0.5,
                noise_floor_dn: 2.0,
                psf: None,
                work: &work,
            };
            let starts = [model(19.8, 19.8, 7000.0), model(21.0, 21.5, 6000.0)];
            let breadth = WidthFactor { ln: 0.0, sigma: if broader == 1.0 { 0.0 } else { 10.0 } };
            let fits = scene.fit_two(starts, typical, breadth, &[]).unwrap();
            for (fit, star) in fits.iter().zip(&truth) {
                let far_px = (fit.model.x - star.x).hypot(fit.model.y - star.y);
                assert!(far_px < 2e-4 && (fit.model.flux_dn / star.flux_dn - 1.0).abs() < 3e-4, "{typical:?}: {:?}", fit.model);
                assert!((fit.model.shape.sigma_px() / shape.sigma_px() - 1.0).abs() < 2e-4 && fit.chi2 < 1e-3, "{}", fit.chi2);
            }
            // errors of both together are larger than of either with the other known
            let other = truth[1];
            let alone = scene.fit(Model { shape, ..truth[0] }, Freedom::Fixed, &[other]).unwrap();
            assert!(fits[0].covariance_px2[0] > 1.05 * alone.covariance_px2[0]);
        }
    }
}
