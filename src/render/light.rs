//! From a star's way over the frame to points of light.

use std::sync::Arc;

use super::mosaic;
use super::psf_tables::PsfTables;
use crate::coordinates::PixelPoint;
use crate::effects::optics::atlas_psf::AtlasPsf;
use crate::effects::optics::disc_psf::{self, DiscPsf};
use crate::effects::optics::elliptic_gaussian_psf::{self, EllipticGaussianPsf};
use crate::effects::optics::gaussian_psf::GaussianPsf;
use crate::effects::optics::tables::AtlasBuilder;
use crate::effects::pixel::{Atlas, Psf2d, SeparablePsf};
use crate::imaging::{Imager, ImagingError, PlacedStar, PlaneLight, PointSource, Stamp};
use crate::parallel;
use crate::scene::{LightForm, OtherLight, Psf, PsfKind, Sample, Spot, StarTrack};
use crate::units::DEG_RAD;

/// Spreads the light of stars as a scene's `[psf]` says, on the detector's own pixels.
#[derive(Debug)]
pub(super) struct Spreader {
    /// Its places are those of the frame, its lengths those of the detector's own pixels.
    psf: Psf,
    atlas: Atlas,
    /// The light that each of its tables holds: they end where light is no longer followed.
    shares: Vec<f64>,
}

/// The light of one star: what the fast, separable spread takes, and what has to be spread point by point.
#[derive(Clone, Debug, Default)]
pub(super) struct StarLight {
    stars: Vec<PlacedStar>,
    deposits: Vec<PointSource>,
    discs: Vec<PointSource>,
    /// What red, green and blue pixels count of it, where there are filters.
    pub(super) through: Option<[f64; 3]>,
}

impl StarLight {
    /// At how many places it is put down.
    pub(super) fn places(&self) -> usize {
        self.stars.len() + self.deposits.len()
    }
}

/// All the light of an exposure.
#[derive(Clone, Debug, Default)]
pub(super) struct FrameLight {
    pub(super) stars: Vec<PlacedStar>,
    deposits: Vec<PointSource>,
    discs: Vec<PointSource>,
    /// What the filters let through, red, green and blue, where there are any.
    filtered: Option<Box<[FrameLight; 3]>>,
}

impl<'a> FromIterator<&'a StarLight> for FrameLight {
    fn from_iter<I: IntoIterator<Item = &'a StarLight>>(lights: I) -> Self {
        let mut frame = Self::default();
        for light in lights {
            frame.add(light, 1.0);
            if let Some(through) = light.through {
                for (filtered, share) in frame.filtered.get_or_insert_default().iter_mut().zip(through) {
                    filtered.add(light, share);
                }
            }
        }
        frame
    }
}

impl FrameLight {
    /// Adds a share of a light.
    fn add(&mut self, light: &StarLight, share: f64) {
        let weaker = |deposit: &PointSource| PointSource { electrons: share * deposit.electrons, ..*deposit };
        self.stars.extend(light.stars.iter().map(|star| PlacedStar { electrons: share * star.electrons, ..*star }));
        self.deposits.extend(light.deposits.iter().map(weaker));
        self.discs.extend(light.discs.iter().map(weaker));
    }

    /// What the filters let through, red, green and blue; `None` where there are none.
    pub(super) fn filtered(&self) -> Option<&[Self; 3]> {
        self.filtered.as_deref()
    }

    /// This light and more.
    pub(super) fn with(&self, more: &Self) -> Self {
        let mut all = self.clone();
        all.stars.extend_from_slice(&more.stars);
        all.deposits.extend_from_slice(&more.deposits);
        all.discs.extend_from_slice(&more.discs);
        if let Some(more) = &more.filtered {
            for (own, more) in all.filtered.get_or_insert_default().iter_mut().zip(&**more) {
                *own = own.with(more);
            }
        }
        all
    }
}

impl Spreader {
    /// Works out the tables, if the scene's images need any and they are not known already.
    pub(super) fn new(psf: &Psf, known: &PsfTables) -> Self {
        let make = || Self::atlas(psf, known);
        let atlas = if psf.grid().is_some() { known.get_or_make(psf, make) } else { Atlas::default() };
        Self { psf: psf.clone(), shares: atlas.shares(), atlas }
    }

    fn atlas(psf: &Psf, known: &PsfTables) -> Atlas {
        psf.grid().map_or_else(Atlas::default, |grid| {
            let mut builder = AtlasBuilder::new(grid, psf.reach_px);
            let table = |node: usize| {
                match &psf.kind {
                    PsfKind::Tables(kind) => {
                        // −0 and 0 are the same image.
                        let parameters: Vec<f64> = psf.parameters_at(&psf.node(node)).iter().map(|value| value + 0.0).collect();
                        let name = format!("{} {parameters:?} {grid:?} {} {:?}", kind.id(), psf.reach_px, psf.pixel);
                        known.image(name, || builder.table(kind.transfer(&parameters, &grid), &psf.pixel))
                    }
                    PsfKind::Sampled(image) => Arc::from(builder.table(image.transfer(&grid, image.grid(psf.reach_px).1), &psf.pixel)),
                    PsfKind::Gaussian | PsfKind::Elliptic => Arc::default(), // they have no grid
                }
            };
            let tables: Vec<Arc<[f32]>> = parallel::map_numbers(psf.nodes.count(), table);
            for table in &tables {
                builder.add(table);
            }
            builder.finish()
        })
    }

    /// How far outside the frame a star may stand and still light it, px.
    pub(super) fn margin_px(&self) -> f64 {
        /// Beyond so many widths lies less than 1e-9 of a Gaussian's light.
        const SIGMAS: f64 = 6.0;
        let own_px = match self.psf.kind {
            PsfKind::Gaussian | PsfKind::Elliptic => SIGMAS * self.widest_px() + 1.0,
            PsfKind::Tables(_) | PsfKind::Sampled(_) => self.psf.reach_px as f64 + 2.0,
        };
        own_px / self.finer()
    }

    /// The detector's own pixels along a pixel of the frame.
    fn finer(&self) -> f64 {
        self.psf.own_per_px as f64
    }

    /// A place of the frame among the detector's own pixels, px.
    fn own_place(&self, place: PixelPoint) -> [f64; 2] {
        [place.x_px, place.y_px].map(|place| self.finer() * place + 0.5 * (self.finer() - 1.0))
    }

    /// Covariance of motion that is faster than the exposure, in the detector's own pixels.
    fn blur_px2(&self, track: &StarTrack) -> [f64; 3] {
        track.blur_px2.map(|blur| self.finer() * self.finer() * blur)
    }

    /// The largest width over the field and all colours, px.
    pub(super) fn widest_px(&self) -> f64 {
        self.psf.widest_px()
    }

    fn spread(&self) -> &'static dyn Psf2d {
        match self.psf.kind {
            PsfKind::Gaussian => &GaussianPsf,
            PsfKind::Elliptic => &EllipticGaussianPsf,
            PsfKind::Tables(_) | PsfKind::Sampled(_) => &AtlasPsf,
        }
    }

    /// What goes to the pixels besides the separable stars.
    pub(super) fn planes<'a>(&'a self, frame: &'a FrameLight) -> Vec<PlaneLight<'a>> {
        self.batches(&frame.deposits, &frame.discs)
    }

    fn batches<'a>(&'a self, deposits: &'a [PointSource], discs: &'a [PointSource]) -> Vec<PlaneLight<'a>> {
        let own = PlaneLight { spread: self.spread(), atlas: &self.atlas, deposits };
        let ghosts = PlaneLight { spread: &DiscPsf, atlas: &self.atlas, deposits: discs };
        [own, ghosts].into_iter().filter(|batch| !batch.deposits.is_empty()).collect()
    }

    /// Electrons that its images hold, on the frame and beside it.
    pub(super) fn whole_e(&self, light: &StarLight) -> f64 {
        let of_tables = |point: &PointSource| {
            let share: f64 =
                point.nodes.iter().filter_map(|(node, weight)| Some(f64::from(*weight) * self.shares.get(*node as usize)?)).sum();
            point.electrons * if self.shares.is_empty() { 1.0 } else { share }
        };
        let of_stars: f64 = light.stars.iter().map(|star| star.electrons).sum();
        let of_discs: f64 = light.discs.iter().map(|disc| disc.electrons).sum();
        of_stars + of_discs + light.deposits.iter().map(of_tables).sum::<f64>()
    }

    /// Its light on the pixels, and no other.
    pub(super) fn stamp(&self, light: &StarLight, imager: &Imager) -> Result<Option<Stamp>, ImagingError> {
        let mut stamp = imager.stamp(&light.stars, &self.batches(&light.deposits, &light.discs))?;
        if let (Some(stamp), Some(through)) = (&mut stamp, light.through) {
            mosaic::filter(stamp, through);
        }
        Ok(stamp)
    }

    /// The same light so many pixels of the frame to the right and down.
    pub(super) fn moved(&self, light: &StarLight, by_px: [f64; 2]) -> StarLight {
        let [right, down] = by_px.map(|by_px| self.finer() * by_px);
        let mut moved = light.clone();
        for star in &mut moved.stars {
            (star.x_px, star.y_px) = (star.x_px + right, star.y_px + down);
        }
        for point in moved.deposits.iter_mut().chain(&mut moved.discs) {
            (point.x_px, point.y_px) = (point.x_px + right, point.y_px + down);
        }
        moved
    }

    /// The light of a star. Motion that is faster than the exposure widens Gaussians; other images are put down at several places.
    pub(super) fn light(&self, track: &StarTrack) -> StarLight {
        let mut light = StarLight::default();
        for sample in &track.samples {
            match self.psf.kind {
                PsfKind::Gaussian => self.round(track, sample, &mut light),
                PsfKind::Elliptic => self.elliptic(track, sample, &mut light),
                PsfKind::Tables(_) | PsfKind::Sampled(_) => self.tabled(track, sample, &mut light),
            }
        }
        light
    }

    /// The light of what is no star.
    pub(super) fn other(&self, other: &OtherLight) -> StarLight {
        /// Widths of charge along a track between two points of light at most.
        const STEP: f64 = 1.1;
        match &other.form {
            LightForm::Trail(track) => self.light(track),
            LightForm::Disc { radius_px, hole_px } => {
                let [x_px, y_px] = self.own_place(other.ends[0]);
                let [radius_px, hole_px] = [radius_px, hole_px].map(|radius| self.finer() * radius);
                let image = PlacedStar { x_px, y_px, electrons: other.electrons, sigma_px: 1.0 };
                let shape = disc_psf::shape(radius_px, hole_px);
                let disc = PointSource { shape, ..PointSource::round(&image, (radius_px + 1.5).ceil() as u16) };
                StarLight { discs: vec![disc], ..StarLight::default() }
            }
            LightForm::Track { sigma_px } => {
                let sigma_px = self.finer() * sigma_px;
                let [from, to] = other.ends.map(|end| self.own_place(end));
                let (dx, dy) = (to[0] - from[0], to[1] - from[1]);
                let count = (dx.hypot(dy) / (STEP * sigma_px)).ceil().clamp(1.0, 1e5);
                let point = |k: usize| {
                    let share = (k as f64 + 0.5) / count;
                    let (x_px, y_px) = (from[0] + share * dx, from[1] + share * dy);
                    PlacedStar { x_px, y_px, electrons: other.electrons / count, sigma_px }
                };
                StarLight { stars: (0..count as usize).map(point).collect(), ..StarLight::default() }
            }
        }
    }

    fn parameters(&self, track: &StarTrack, sample: &Sample) -> Vec<f64> {
        self.psf.parameters_at(&spot(track, sample))
    }

    /// By the smaller of the two variances the Gaussian is wider in all directions; the rest, along the axis of the larger, is put down point by
    /// point.
    fn round(&self, track: &StarTrack, sample: &Sample, light: &mut StarLight) {
        let sigma_px = self.parameters(track, sample)[0];
        let [least, rest] = principal_px2(self.blur_px2(track));
        let [x_px, y_px] = self.own_place(sample.place);
        let sigma_px = (sigma_px * sigma_px + least.variance).sqrt();
        let spread = (rest.variance - least.variance).max(0.0).sqrt();
        for [offset, share] in normal_nodes(spread, sigma_px) {
            let image = PlacedStar {
                x_px: x_px + offset * rest.axis[0],
                y_px: y_px + offset * rest.axis[1],
                electrons: track.electrons * sample.weight * share,
                sigma_px,
            };
            if sample.shear == [0.0; 2] {
                light.stars.push(image);
            } else {
                let reach = GaussianPsf.reach(track.electrons, sigma_px) as u16;
                light.deposits.push(PointSource { shear: sample.shear, ..PointSource::round(&image, reach) });
            }
        }
    }

    fn elliptic(&self, track: &StarTrack, sample: &Sample, light: &mut StarLight) {
        let parameters = self.parameters(track, sample);
        let own = elliptic_gaussian_psf::covariance_px2(parameters[0], parameters[1], parameters[2] * DEG_RAD);
        let blur = self.blur_px2(track);
        let covariance = [0, 1, 2].map(|k| own[k] + blur[k]);
        let [_, major] = principal_px2(covariance);
        let (sigma_px, shape) = elliptic_gaussian_psf::shape(covariance);
        let [x_px, y_px] = self.own_place(sample.place);
        let image = PlacedStar { x_px, y_px, electrons: track.electrons * sample.weight, sigma_px };
        let reach = GaussianPsf.reach(track.electrons, major.variance.sqrt()) as u16;
        light.deposits.push(PointSource { shear: sample.shear, shape, ..PointSource::round(&image, reach) });
    }

    fn tabled(&self, track: &StarTrack, sample: &Sample, light: &mut StarLight) {
        let nodes = self.psf.mixture(&spot(track, sample));
        let [x_px, y_px] = self.own_place(sample.place);
        let [minor, major] =
            principal_px2(self.blur_px2(track)).map(|one| (normal_nodes(one.variance.sqrt(), self.psf.smooth_px), one.axis));
        for [along, share] in &major.0 {
            for [across, part] in &minor.0 {
                let image = PlacedStar {
                    x_px: x_px + along * major.1[0] + across * minor.1[0],
                    y_px: y_px + along * major.1[1] + across * minor.1[1],
                    electrons: track.electrons * sample.weight * share * part,
                    sigma_px: 1.0,
                };
                let reach = self.psf.reach_px as u16 + 1;
                light.deposits.push(PointSource { shear: sample.shear, nodes, ..PointSource::round(&image, reach) });
            }
        }
    }
}

/// What a star's image depends on at a moment.
fn spot(track: &StarTrack, sample: &Sample) -> Spot {
    let (x_px, y_px) = (sample.place.x_px, sample.place.y_px);
    Spot { x_px, y_px, colour: track.colour, temperature_offset_k: track.temperature_offset_k }
}

/// A principal axis of a covariance.
#[derive(Clone, Copy, Debug)]
struct Principal {
    variance: f64,
    axis: [f64; 2],
}

/// The principal axes of a covariance (xx, xy, yy), that of the smaller variance first.
fn principal_px2([xx, xy, yy]: [f64; 3]) -> [Principal; 2] {
    let (middle, half) = (0.5 * (xx + yy), (0.5 * (xx - yy)).hypot(xy));
    let (sine, cosine) = (0.5 * (2.0 * xy).atan2(xx - yy)).sin_cos();
    [Principal { variance: (middle - half).max(0.0), axis: [-sine, cosine] }, Principal { variance: middle + half, axis: [cosine, sine] }]
}

/// Nodes and weights of a normal distribution of width `spread_px` for functions as smooth as a Gaussian of width `sigma_px`. A single node for a width
/// of nothing. For narrow ones Gauss and Hermite's rule of n = 2 to 4 nodes: its error n!/(2n)!·f⁽²ⁿ⁾·s²ⁿ stays below 1e-7 of the light up to the ratios
/// that stand here. Else the trapezoidal rule, whose error falls as exp(−2π²w²/h²) with the step h and the width w of the product of the two.
/// Source: Abramowitz and Stegun, 25.4.46.
fn normal_nodes(spread_px: f64, sigma_px: f64) -> Vec<[f64; 2]> {
    const REACH: f64 = 5.3;
    let (root3, root6) = (3.0_f64.sqrt(), 6.0_f64.sqrt());
    let (inner, outer) = ((3.0 - root6).sqrt(), (3.0 + root6).sqrt());
    let (more, less) = ((3.0 + root6) / 12.0, (3.0 - root6) / 12.0);
    let rule: &[[f64; 2]] = match spread_px / sigma_px {
        ..1e-3 => return vec![[0.0, 1.0]],
        ..0.02 => &[[-1.0, 0.5], [1.0, 0.5]],
        ..0.09 => &[[-root3, 1.0 / 6.0], [0.0, 2.0 / 3.0], [root3, 1.0 / 6.0]],
        ..0.16 => &[[-outer, less], [-inner, more], [inner, more], [outer, less]],
        _ => &[],
    };
    if !rule.is_empty() {
        return rule.iter().map(|[node, weight]| [node * spread_px, *weight]).collect();
    }
    let step = 1.1 * spread_px * sigma_px / spread_px.hypot(sigma_px);
    let half = (REACH * spread_px / step).ceil() as i32;
    let nodes = (-half..=half).map(|index| f64::from(index) * step);
    let nodes: Vec<[f64; 2]> = nodes.map(|node| [node, (-0.5 * (node / spread_px).powi(2)).exp()]).collect();
    let sum: f64 = nodes.iter().map(|[_, weight]| weight).sum();
    nodes.into_iter().map(|[node, weight]| [node, weight / sum]).collect()
}

#[cfg(test)]
mod tests {
    use super::normal_nodes;

    /// A Gaussian that is smeared by a normal distribution is one of the sum of the variances, whichever rule is taken.
    #[test]
    fn smeared_gaussians_are_wider_gaussians() {
        let mut most_nodes = 0;
        for ratio in [1e-4, 0.002, 0.019, 0.021, 0.05, 0.089, 0.091, 0.15, 0.161, 0.3, 1.0, 3.0_f64] {
            let (sigma, nodes) = (0.8, normal_nodes(0.8 * ratio, 0.8));
            let density = |x: f64, sigma: f64| (-0.5 * (x / sigma).powi(2)).exp() / sigma;
            let smeared = |x: f64| nodes.iter().map(|[node, weight]| weight * density(x - node, sigma)).sum::<f64>();
            for x in [0.0, 0.3, 0.8, 1.7, 3.0] {
                let (found, expected) = (smeared(x), density(x, sigma * (1.0 + ratio * ratio).sqrt()));
                assert!((found - expected).abs() < 1e-6, "ratio {ratio}, x {x}: {found} instead of {expected}");
            }
            if ratio < 0.16 {
                most_nodes = most_nodes.max(nodes.len());
            }
        }
        assert_eq!(most_nodes, 4);
        // The test can fail: fewer nodes do not do for wide ones.
        let two = [[-0.4, 0.5], [0.4, 0.5]].iter().map(|[node, weight]| weight * (-0.5_f64 * (node / 0.8_f64).powi(2)).exp()).sum::<f64>();
        assert!((two - 1.0 / (1.25_f64).sqrt()).abs() > 1e-3);
    }
}
