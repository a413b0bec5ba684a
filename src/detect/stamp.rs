//! The pixels of a star: cut out of its frame with their noise, the light of others taken off, and those left out that no star explains.

use super::background::Background;
use super::epsf::EmpiricalPsf;
use super::image_model::{Model, Window};
use super::psf::Profile;
use super::work::Work;
use crate::frame::Frame;
use crate::statistics::order::sort_by;

/// Residuals of a single pixel beyond this many σ are no noise: a hot pixel, a cosmic ray, another star.
const OUTLIER_SIGMA: f64 = 6.0;
/// So often they are looked for anew.
pub(super) const MAX_DROPS: usize = 3;
/// How far a real star's image may differ from the Gaussian at any pixel: share of the model there, and of its peak.
const MODEL_SLACK: (f64, f64) = (0.1, 0.02);

/// What fits read.
#[derive(Clone, Copy)]
pub(super) struct Scene<'a> {
    pub(super) frame: &'a Frame,
    pub(super) background: &'a Background,
    /// Pixels that say nothing: hot or saturated.
    pub(super) masked: &'a [bool],
    /// Variance of the counts per count of signal: 1 / gain.
    pub(super) variance_per_dn: f64,
    /// Smallest noise of a pixel, DN, as declared.
    pub(super) noise_floor_dn: f64,
    /// The image of a star where it is known from the recording's own stars.
    pub(super) psf: Option<&'a EmpiricalPsf>,
    /// What fits cost.
    pub(super) work: &'a Work,
}

/// How the noise grows with the light: all that the fit of a stamp needs besides it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Photons {
    /// Variance of the counts per count of signal: 1 / gain.
    pub(super) variance_per_dn: f64,
}

/// The pixels of one star.
#[derive(Clone, Debug)]
pub(super) struct Stamp {
    pub(super) window: Window,
    /// Counts less the mesh background and the neighbours.
    pub(super) data: Vec<f64>,
    /// Noise² without the star.
    pub(super) variance: Vec<f64>,
    pub(super) used: Vec<bool>,
    pub(super) edge: bool,
    pub(super) peak_dn: f64,
}

/// The window of a star, and whether the edge of the frame cuts it.
fn window(frame: &Frame, x: f64, y: f64, radius: usize) -> (Window, bool) {
    let span = |at: f64, length: usize| {
        let at = at.round().clamp(0.0, (length - 1) as f64) as usize;
        let (low, high) = (at.saturating_sub(radius), (at + radius + 1).min(length));
        (low, high - low, high - low < 2 * radius + 1)
    };
    let ((x0, columns, cut_x), (y0, rows, cut_y)) = (span(x, frame.width_px), span(y, frame.height_px));
    (Window { x0, y0, columns, rows }, cut_x || cut_y)
}

impl<'a> Scene<'a> {
    /// What draws images, counted.
    pub(super) fn profile(&self) -> Profile<'a> {
        Profile::of(self.psf).counted(self.work)
    }

    pub(super) fn photons(&self) -> Photons {
        Photons { variance_per_dn: self.variance_per_dn }
    }

    pub(super) fn stamp(&self, start: Model, neighbours: &[Model], profile: &mut Profile<'_>) -> Stamp {
        let (window, edge) = window(self.frame, start.x, start.y, start.radius);
        let pixels = window.columns * window.rows;
        let mut stamp = Stamp {
            window,
            data: Vec::with_capacity(pixels),
            variance: Vec::with_capacity(pixels),
            used: Vec::with_capacity(pixels),
            edge,
            peak_dn: f64::NEG_INFINITY,
        };
        for y in window.y0..window.y0 + window.rows {
            for x in window.x0..window.x0 + window.columns {
                let count = f64::from(self.frame.at(x, y));
                stamp.peak_dn = stamp.peak_dn.max(count);
                stamp.data.push(count - self.background.level_dn(x, y));
                let noise = self.background.noise_dn(x, y).max(self.noise_floor_dn);
                stamp.variance.push(noise * noise);
                stamp.used.push(!self.masked[y * self.frame.width_px + x]);
            }
        }
        for other in neighbours {
            profile.draw(window, other, false);
            for ((data, variance), share) in stamp.data.iter_mut().zip(&mut stamp.variance).zip(&profile.value) {
                let light = (other.flux_dn * share).max(0.0);
                *data -= light;
                *variance += light * self.variance_per_dn;
            }
        }
        stamp
    }
}

impl Photons {
    /// Leaves out pixels far off the model; says whether there were any.
    pub(super) fn drop_outliers(self, stamp: &mut Stamp, (model, offset): &(Model, f64), profile: &mut Profile<'_>) -> bool {
        profile.draw(stamp.window, model, false);
        self.drop_far(stamp, |i| model.flux_dn * profile.value[i], *offset)
    }

    /// The same of any light.
    pub(super) fn drop_far(self, stamp: &mut Stamp, light_dn: impl Fn(usize) -> f64, offset: f64) -> bool {
        let top = (0..stamp.data.len()).map(&light_dn).fold(0.0, f64::max);
        let mut worst: Vec<(f64, usize)> = Vec::new();
        for i in 0..stamp.data.len() {
            let signal = light_dn(i);
            let slack = MODEL_SLACK.0 * signal + MODEL_SLACK.1 * top;
            let sigma = (stamp.variance[i] + signal.max(0.0) * self.variance_per_dn + slack * slack).sqrt();
            let excess = (stamp.data[i] - signal - offset).abs() / sigma;
            if stamp.used[i] && excess > OUTLIER_SIGMA {
                worst.push((excess, i));
            }
        }
        sort_by(&mut worst, |a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        worst.truncate(stamp.data.len() / 30 + 1);
        for (_, i) in &worst {
            stamp.used[*i] = false;
        }
        !worst.is_empty()
    }
}
