//! The truth of a rendered frame: where every star landed and how bright it was. The measuring side of the program never reads it.

use super::pixel_shift::PixelShift;
use crate::coordinates::PixelPoint;
use crate::imaging::{Binning, BinningPlace, NoiseFree, Stamp, StampLight};
use crate::scene::{LightKind, OtherLight, Scene, StarTrack};
use crate::statistics::order::ascending;
use serde::{Deserialize, Serialize};

/// One star in one frame; a row of `truth/stars.csv`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct TrueStar {
    /// Index of the frame.
    pub frame: usize,
    /// Catalogue number.
    pub hip: u32,
    /// Column at the middle of the exposure (with a rolling shutter: of the exposure of the row that is lit).
    pub x_px: f64,
    /// Row at the middle of the exposure.
    pub y_px: f64,
    /// Mean column over the time that the star lights the frame: where its light has its centre.
    pub x_mean_px: f64,
    /// Mean row.
    pub y_mean_px: f64,
    /// Column at the start of the exposure; absent where the star has no image then.
    pub x_start_px: Option<f64>,
    /// Row at the start.
    pub y_start_px: Option<f64>,
    /// Column at the end.
    pub x_end_px: Option<f64>,
    /// Row at the end.
    pub y_end_px: Option<f64>,
    /// V magnitude.
    pub magnitude: f64,
    /// Electrons that the star sends during the exposure.
    pub electrons_asked: f64,
    /// Of these, how many are expected to be counted in the frame's pixels, after all that weakens light on the way (vignetting, stops, veiling
    /// glare, filters, the pixels' response), before charge is moved or cut.
    pub electrons_landed: f64,
    /// The same in its brightest pixel.
    pub peak_electrons: f64,
    /// Electrons over their expected standard error where every pixel is weighted in the best way: √Σ s²/(s + background + read noise² + gain²/12),
    /// the last of the rounding to counts.
    pub snr: f64,
    /// One of its pixels is expected to be full, by its own light and the background.
    pub saturated: bool,
    /// Another star with at least a twentieth of this one's light lies within 6 σ of the PSF.
    pub blended: bool,
    /// Part of the light falls beside the frame (more than 1 %).
    pub edge: bool,
    /// Column at which a camera of the true projection, focal length and principal point would show the catalogue's direction at the middle of
    /// the exposure, if nothing displaced it: neither the sky (from proper motion to refraction) nor distortion nor detector.
    pub x_ideal_px: Option<f64>,
    /// Row of the same.
    pub y_ideal_px: Option<f64>,
    /// Electrons that its brightest pixel is expected to hold without any star: sky, stray light, dark current.
    pub background_e: f64,
    /// Shift along the columns that pixel effects add, before saturation and converter: the centre of the star's light, weighted by its electrons,
    /// after all of them less that before the first. Zero where no such effect is on; absent beside other stars, at the edge, and where it was
    /// not asked for. Windows reach 4 σ and 3 px beyond the star's way.
    pub x_pixels_px: Option<f64>,
    /// The same along the rows.
    pub y_pixels_px: Option<f64>,
    /// Electrons in that window after all pixel effects over those before the first.
    pub flux_pixels_ratio: Option<f64>,
}

/// What shines or leaves charge and is no star; a row of `truth/lights.csv`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct TrueLight {
    /// Index of the frame.
    pub frame: usize,
    /// What it is.
    pub kind: LightKind,
    /// Of a ghost: the catalogue number of its star.
    pub hip: Option<u32>,
    /// Column where it begins; of a ghost, its middle.
    pub x_start_px: f64,
    /// Row where it begins.
    pub y_start_px: f64,
    /// Column where it ends.
    pub x_end_px: f64,
    /// Row where it ends.
    pub y_end_px: f64,
    /// Electrons that it sends or leaves.
    pub electrons_asked: f64,
    /// Of these, how many are expected on the frame's pixels.
    pub electrons_landed: f64,
    /// Expected electrons in its brightest pixel.
    pub peak_electrons: f64,
}

impl TrueLight {
    /// Of a light in frame `index` of which this lands.
    pub(super) fn new(index: usize, other: &OtherLight, landed: Landed) -> Self {
        let [start, end] = other.ends;
        Self {
            frame: index,
            kind: other.kind,
            hip: other.hip,
            x_start_px: start.x_px,
            y_start_px: start.y_px,
            x_end_px: end.x_px,
            y_end_px: end.y_px,
            electrons_asked: other.electrons,
            electrons_landed: landed.electrons,
            peak_electrons: landed.peak_electrons,
        }
    }
}

/// What one star's light is on the frame's pixels, without any other's.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Landed {
    electrons: f64,
    peak_electrons: f64,
    pub(super) background_e: f64,
    pub(super) snr: f64,
    pub(super) is_full: bool,
    /// The share of all its light that reaches the frame, before anything weakens it.
    on_frame_share: f64,
}

/// What the rounding to counts adds to the variance of a pixel, or of a joined one, in electrons squared: electrons of a count are all as likely.
fn rounding_variance(scene: &Scene) -> f64 {
    let of = |gain_e_per_dn: f64| gain_e_per_dn.powi(2) / 12.0;
    let gain_e_per_dn = scene.detector.gain_e_per_dn;
    let Some(binning) = scene.binning else { return of(gain_e_per_dn) };
    let of_joined = of(gain_e_per_dn / binning.share());
    let of_each = binning.pixels() * of(gain_e_per_dn);
    match binning.place {
        BinningPlace::OnChip => of_joined,
        BinningPlace::Digital if binning.is_mean => of_each + of_joined,
        BinningPlace::Digital => of_each,
    }
}

/// A light in the pixels of the frame that hold any of it.
#[derive(Clone, Debug)]
pub(super) struct Seen {
    pub(super) left_px: usize,
    pub(super) top_px: usize,
    pub(super) width_px: usize,
    pub(super) light: StampLight,
    /// Electrons before anything weakens them.
    sent_e: Vec<f64>,
    pub(super) read_variance: f64,
    is_full: bool,
}

impl Seen {
    /// Of a source with this light.
    pub(super) fn new(scene: &Scene, chain: &NoiseFree<'_>, stamp: &Stamp) -> Self {
        let seen = chain.seen(stamp);
        let is_full = chain.is_full(stamp, &seen);
        let sent_e: Vec<f64> = stamp.electrons.iter().map(|electrons| f64::from(*electrons)).collect();
        let (left_px, top_px, width_px) = (stamp.left_px, stamp.top_px, stamp.width_px);
        // A dark frame stands in the place of read noise; pixels are not joined then.
        let read_noise_e = scene.dark_frame.as_ref().map_or(chain.read_noise_e(), |dark| dark.noise_e);
        let rounding = rounding_variance(scene);
        let own = Self { left_px, top_px, width_px, light: seen, sent_e, read_variance: read_noise_e.powi(2) + rounding, is_full };
        let Some(binning) = scene.binning else { return own };
        let joined = Joined::new(binning.factor, stamp);
        let light = StampLight { electrons: joined.sums(&own.light.electrons), background_e: joined.sums(&own.light.background_e) };
        Self {
            left_px: joined.left,
            top_px: joined.top,
            width_px: joined.width,
            sent_e: joined.sums(&own.sent_e),
            read_variance: (chain.read_noise_e() * binning.read_noise_factor()).powi(2) + rounding,
            is_full: own.is_full || is_joined_full(scene, &light),
            light,
        }
    }

    /// The centre of the light that reaches the pixels; `None` where they end with the frame, so that light may be missing.
    pub(super) fn centre_px(&self, [columns, rows]: [usize; 2]) -> Option<[f64; 2]> {
        let end = [self.left_px + self.width_px, self.top_px + self.sent_e.len() / self.width_px.max(1)];
        let is_whole = self.left_px > 0 && self.top_px > 0 && end[0] < columns && end[1] < rows;
        self.centre_of(&self.sent_e).filter(|_| is_whole)
    }

    /// The centre of the electrons that are expected on the frame.
    pub(super) fn light_centre_px(&self) -> Option<[f64; 2]> {
        self.centre_of(&self.light.electrons)
    }

    /// The centre of electrons in its pixels; `None` where there are none.
    fn centre_of(&self, electrons: &[f64]) -> Option<[f64; 2]> {
        let (mut sum, mut moments) = (0.0, [0.0; 2]);
        for (y, row) in (self.top_px..).zip(electrons.chunks_exact(self.width_px.max(1))) {
            let y = y as f64;
            for (x, electrons) in (self.left_px..).zip(row) {
                sum += electrons;
                moments[0] += electrons * x as f64;
                moments[1] += electrons * y;
            }
        }
        (sum > 0.0).then(|| moments.map(|moment| moment / sum))
    }

    /// What its pixels would see of the same light elsewhere.
    pub(super) fn beside(&self, scene: &Scene, stamp: &Stamp) -> Vec<f64> {
        let own: Vec<f64> = stamp.electrons.iter().map(|electrons| f64::from(*electrons)).collect();
        let (left, top, width, sent_e) = match scene.binning {
            None => (stamp.left_px, stamp.top_px, stamp.width_px, own),
            Some(binning) => {
                let joined = Joined::new(binning.factor, stamp);
                (joined.left, joined.top, joined.width, joined.sums(&own))
            }
        };
        let own_width = self.width_px.max(1);
        let mut all = vec![0.0; self.sent_e.len()];
        let (first, skipped) = (left.saturating_sub(self.left_px), self.left_px.saturating_sub(left));
        for (y, own) in (self.top_px..).zip(all.chunks_exact_mut(own_width)) {
            let row = y.checked_sub(top).and_then(|row| sent_e.get(row * width..(row + 1) * width)).unwrap_or_default();
            own.iter_mut().skip(first).zip(row.iter().skip(skipped)).for_each(|(own, sent)| *own = *sent);
        }
        // The share that is seen is that of the pixel, or where it is not known, all.
        for ((own, sent), seen) in all.iter_mut().zip(&self.sent_e).zip(&self.light.electrons) {
            *own = if *sent > 0.0 { *own * seen / sent } else { *own };
        }
        all
    }

    /// All of it together, of a light that holds so many electrons on the frame and beside it.
    pub(super) fn landed(&self, whole_e: f64) -> Landed {
        let on_frame_share = self.sent_e.iter().sum::<f64>() / whole_e.max(f64::MIN_POSITIVE);
        let mut landed = Landed { is_full: self.is_full, on_frame_share, ..Landed::default() };
        let mut information = 0.0;
        for (electrons, background_e) in self.light.electrons.iter().zip(&self.light.background_e) {
            landed.electrons += electrons;
            if *electrons > landed.peak_electrons {
                (landed.peak_electrons, landed.background_e) = (*electrons, *background_e);
            }
            if *electrons > 0.0 {
                information += electrons * electrons / (electrons + background_e + self.read_variance);
            }
        }
        Landed { snr: information.sqrt(), ..landed }
    }
}

/// Pixels of the frame into which those of a stamp are joined, `factor` × `factor` of them each.
struct Joined<'a> {
    factor: usize,
    stamp: &'a Stamp,
    left: usize,
    top: usize,
    width: usize,
    height: usize,
}

impl<'a> Joined<'a> {
    fn new(factor: usize, stamp: &'a Stamp) -> Self {
        let [left, top] = [stamp.left_px / factor, stamp.top_px / factor];
        let rows = stamp.electrons.len() / stamp.width_px;
        let width = (stamp.left_px + stamp.width_px - 1) / factor + 1 - left;
        let height = (stamp.top_px + rows - 1) / factor + 1 - top;
        Self { factor, stamp, left, top, width, height }
    }

    fn sums(&self, own: &[f64]) -> Vec<f64> {
        let Self { factor, stamp, left, top, width, height } = *self;
        let mut sums = vec![0.0; width * height];
        for (place, value) in own.iter().enumerate() {
            let [x, y] = [stamp.left_px + place % stamp.width_px, stamp.top_px + place / stamp.width_px];
            sums[(y / factor - top) * width + x / factor - left] += value;
        }
        sums
    }
}

/// Whether charge that is joined on the chip is expected to reach the top of the converter.
fn is_joined_full(scene: &Scene, seen: &StampLight) -> bool {
    let Some(Binning { place: BinningPlace::OnChip, .. }) = scene.binning else { return false };
    let joined = scene.detector.joined(scene.binning);
    let most = seen.electrons.iter().zip(&seen.background_e).map(|(own, other)| own + other).fold(0.0, f64::max);
    joined.bias_dn + most / joined.gain_e_per_dn >= joined.full_pixel_dn()
}

/// The truth of frame `index`: stars with what of each lands on the pixels.
#[must_use]
pub(super) fn true_stars(
    scene: &Scene,
    index: usize,
    tracks: &[StarTrack],
    landed: &[Landed],
    shifts: &[Option<PixelShift>],
) -> Vec<TrueStar> {
    let blended = blended(tracks, 6.0 * scene.detector.psf_sigma_px, 0.05);
    let stars = tracks.iter().zip(landed).zip(shifts).zip(blended);
    stars.map(|(((track, landed), shift), blended)| true_star(index, track, *landed, *shift, blended)).collect()
}

fn true_star(index: usize, track: &StarTrack, landed: Landed, shift: Option<PixelShift>, blended: bool) -> TrueStar {
    let mean = track.mean();
    let [start, middle, end] = track.start_mid_end;
    let middle = middle.unwrap_or(mean);
    let (x, y) = (|point: PixelPoint| point.x_px, |point: PixelPoint| point.y_px);
    TrueStar {
        frame: index,
        hip: track.hip,
        x_ideal_px: track.ideal.map(x),
        y_ideal_px: track.ideal.map(y),
        x_px: middle.x_px,
        y_px: middle.y_px,
        x_mean_px: mean.x_px,
        y_mean_px: mean.y_px,
        x_start_px: start.map(x),
        y_start_px: start.map(y),
        x_end_px: end.map(x),
        y_end_px: end.map(y),
        magnitude: track.magnitude,
        electrons_asked: track.electrons,
        electrons_landed: landed.electrons,
        peak_electrons: landed.peak_electrons,
        background_e: landed.background_e,
        snr: landed.snr,
        x_pixels_px: shift.map(|shift| shift.x_px),
        y_pixels_px: shift.map(|shift| shift.y_px),
        flux_pixels_ratio: shift.map(|shift| shift.flux_ratio),
        saturated: landed.is_full,
        blended,
        edge: landed.on_frame_share < 0.99,
    }
}

/// For each star, whether the trail of another one with at least this share of its light comes near its own.
pub(super) fn blended(tracks: &[StarTrack], reach_px: f64, share: f64) -> Vec<bool> {
    let trails: Vec<Vec<PixelPoint>> = tracks.iter().map(trail).collect();
    let range = |points: &[PixelPoint], at: fn(&PixelPoint) -> f64| {
        points.iter().map(at).fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], at| [low.min(at), high.max(at)])
    };
    let columns: Vec<[f64; 2]> = trails.iter().map(|points| range(points, |point| point.x_px)).collect();
    let rows: Vec<[f64; 2]> = trails.iter().map(|points| range(points, |point| point.y_px)).collect();
    let mut order: Vec<usize> = (0..tracks.len()).collect();
    ascending(&mut order, |a| columns[*a][0]);
    let mut blended = vec![false; tracks.len()];
    for (rank, &a) in order.iter().enumerate() {
        for &b in order[rank + 1..].iter().take_while(|b| columns[**b][0] - columns[a][1] < reach_px) {
            if rows[b][0] - rows[a][1] >= reach_px || rows[a][0] - rows[b][1] >= reach_px {
                continue;
            }
            // Only what is not known yet is worth a look: where all stars lie on a few pixels, that is next to nothing.
            let learns_a = !blended[a] && tracks[b].electrons >= share * tracks[a].electrons;
            let learns_b = !blended[b] && tracks[a].electrons >= share * tracks[b].electrons;
            if (learns_a || learns_b) && distance_px(&trails[a], &trails[b]) < reach_px {
                blended[a] |= learns_a;
                blended[b] |= learns_b;
            }
        }
    }
    blended
}

/// A star's way as a few points.
fn trail(track: &StarTrack) -> Vec<PixelPoint> {
    const PIECES: usize = 8;
    let places: Vec<PixelPoint> = match track.samples.as_slice() {
        [only] => return vec![only.place],
        samples => samples.iter().map(|sample| sample.place).collect(),
    };
    (0..=PIECES).map(|piece| places[piece * (places.len() - 1) / PIECES]).collect()
}

/// The shortest distance between two polylines, px; the points of one from the pieces of the other.
fn distance_px(a: &[PixelPoint], b: &[PixelPoint]) -> f64 {
    let square = |dx: f64, dy: f64| dx * dx + dy * dy;
    let one_way = |points: &[PixelPoint], line: &[PixelPoint]| {
        let nearest = |point: &PixelPoint| {
            let first = square(line[0].x_px - point.x_px, line[0].y_px - point.y_px);
            let pieces = line.windows(2).map(|piece| {
                let (dx, dy) = (piece[1].x_px - piece[0].x_px, piece[1].y_px - piece[0].y_px);
                let (px, py) = (point.x_px - piece[0].x_px, point.y_px - piece[0].y_px);
                let along = ((px * dx + py * dy) / square(dx, dy).max(1e-30)).clamp(0.0, 1.0);
                square(px - along * dx, py - along * dy)
            });
            pieces.fold(first, f64::min)
        };
        points.iter().map(nearest).fold(f64::INFINITY, f64::min)
    };
    one_way(a, b).min(one_way(b, a)).sqrt()
}
