//! Pixels of one frame that stand out above their neighbours, stars among them: what may be cosmic rays.

use std::collections::BTreeMap;

use super::sky_frame::{SkyFrame, covered};
use super::sky_pixels::{BLOCK_PX, SkyPixels};
use crate::statistics::median_in_place;
use crate::statistics::order::sort_by;

/// A pixel stands out by so much at least, in standard deviations of the sky.
const MIN_SIGMAS: f64 = 6.5;
/// A track is of pixels that hang together and stand out by so much.
const TRACK_SIGMAS: f32 = 4.0;
/// The four pixels of a 2 × 2 cell differ by so much of the noise in a mosaic of colours: a red star is sharp in it.
const MOSAIC: f64 = 1.0;
/// Of a frame so many are kept, the brightest of the sharpest.
const MAX_CANDIDATES: usize = 400;

/// A pixel that stands out.
#[derive(Clone, Copy, Debug)]
pub(super) struct Candidate {
    pub(super) index: usize,
    /// Pixel and neighbours row by row above the sky, in its standard deviations.
    pub(super) around: [f64; 9],
    /// Noise of the sky there, DN.
    pub(super) sigma_dn: f32,
    /// Whether it lies in a star that was found.
    pub(super) in_star: bool,
    /// Number of the pixels that it hangs together with.
    pub(super) group: u32,
}

/// Those of a frame.
#[derive(Clone, Debug)]
pub(super) struct RayFrame {
    /// Number in the recording.
    pub(super) number: usize,
    pub(super) size_px: [usize; 2],
    pub(super) exposure_s: Option<f64>,
    /// Pixels that were searched.
    pub(super) pixels: usize,
    /// Stars that were found.
    pub(super) stars: usize,
    pub(super) candidates: Vec<Candidate>,
}

/// Counts above the sky in its standard deviations; NaN of what is not searched.
pub(super) struct Deviations {
    pub(super) width_px: usize,
    pub(super) values: Vec<f32>,
}

impl RayFrame {
    /// Of a frame and the planes of its sky. Of a mosaic nothing is searched.
    pub(super) fn of(sky_frame: &SkyFrame<'_>, sky: &SkyPixels, deviations: &Deviations) -> Self {
        let size_px = [sky.width_px, sky.height_px];
        if is_mosaic(sky) {
            let (number, exposure_s) = (sky_frame.number, sky_frame.exposure_s);
            return Self { number, size_px, exposure_s, pixels: 0, stars: 0, candidates: Vec::new() };
        }
        let in_star = in_stars(sky_frame);
        let mut groups = Groups::of(deviations);
        let (width, all) = (deviations.width_px, &deviations.values);
        let mut sigmas = BTreeMap::new();
        for block in &sky.blocks {
            sigmas.insert((block.place[0], block.place[1]), block.variance_dn2.sqrt() as f32);
        }
        let candidate = |index: usize| -> Option<Candidate> {
            let (x, y) = (index % width, index / width);
            if f64::from(all[index]) <= MIN_SIGMAS || x == 0 || y == 0 || x + 1 == width || index + width + 1 >= all.len() {
                return None;
            }
            let around: [f64; 9] = std::array::from_fn(|k| f64::from(all[(y + k / 3 - 1) * width + x + k % 3 - 1]));
            // Of equal neighbours the first: the others are no maxima.
            let is_peak = (0..9).all(|k| if k < 4 { around[k] < around[4] } else { around[k] <= around[4] });
            let sigma_dn = *sigmas.get(&(x / BLOCK_PX, y / BLOCK_PX))?;
            is_peak.then_some(Candidate { index, around, sigma_dn, in_star: in_star[index], group: 0 })
        };
        let mut candidates: Vec<Candidate> = (0..all.len()).filter_map(candidate).collect();
        let sharpness = |own: &Candidate| own.around[4] - 0.25 * [1, 3, 5, 7].into_iter().map(|place| own.around[place]).sum::<f64>();
        sort_by(&mut candidates, |a, b| sharpness(b).total_cmp(&sharpness(a)).then(a.index.cmp(&b.index)));
        candidates.truncate(MAX_CANDIDATES);
        for own in &mut candidates {
            own.group = groups.of_pixel(own.index);
        }
        Self {
            number: sky_frame.number,
            size_px,
            exposure_s: sky_frame.exposure_s,
            pixels: all.iter().filter(|value| !value.is_nan()).count(),
            stars: sky_frame.stars.len(),
            candidates,
        }
    }
}

impl Deviations {
    /// Of all pixels in blocks with sky, stars among them.
    pub(super) fn of(sky_frame: &SkyFrame<'_>, sky: &SkyPixels) -> Self {
        let frame = sky_frame.frame;
        let width_px = sky.width_px;
        let mut values = vec![f32::NAN; frame.pixels_dn.len()];
        let middle = (BLOCK_PX - 1) as f64 / 2.0;
        for block in sky.blocks.iter().filter(|block| block.variance_dn2 > 0.0) {
            let by_sigma = block.variance_dn2.sqrt().recip();
            for (row, column) in (0..BLOCK_PX).flat_map(|row| (0..BLOCK_PX).map(move |column| (row, column))) {
                let index = (block.place[1] * BLOCK_PX + row) * width_px + block.place[0] * BLOCK_PX + column;
                let value_dn = frame.pixels_dn[index];
                if value_dn >= frame.saturation_dn || sky_frame.bad.is_some_and(|bad| bad[index]) {
                    continue;
                }
                let plane = block.level_dn + block.slope_dn[0] * (column as f64 - middle) + block.slope_dn[1] * (row as f64 - middle);
                values[index] = ((f64::from(value_dn) - plane) * by_sigma) as f32;
            }
        }
        Self { width_px, values }
    }
}

/// Whether pixels of a 2 × 2 cell see the sky through filters of their own.
fn is_mosaic(sky: &SkyPixels) -> bool {
    let median_of = |cell: usize| {
        let is_of_cell = |(index, _): &(usize, &f32)| index % sky.width_px % 2 + 2 * (index / sky.width_px % 2) == cell;
        let own = sky.residual_dn.iter().enumerate().filter(is_of_cell).filter(|(_, residual)| !residual.is_nan());
        median_in_place(&mut own.map(|(_, residual)| f64::from(*residual)).collect::<Vec<_>>())
    };
    let levels: Vec<f64> = (0..4).filter_map(|cell| Some(median_of(cell)? + sky.cells_dn[cell])).collect();
    let (low, high) = levels.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), own| (low.min(*own), high.max(*own)));
    sky.sigma_dn().is_some_and(|noise_dn| high - low > MOSAIC * noise_dn)
}

/// Which pixels lie in stars.
fn in_stars(sky_frame: &SkyFrame<'_>) -> Vec<bool> {
    let frame = sky_frame.frame;
    let mut in_star = vec![false; frame.pixels_dn.len()];
    for star in sky_frame.stars {
        for y in covered(star.y_px, star.radius_px, frame.height_px) {
            let half = (star.radius_px.powi(2) - (y as f64 - star.y_px).powi(2)).max(0.0).sqrt();
            in_star[y * frame.width_px..][covered(star.x_px, half, frame.width_px)].fill(true);
        }
    }
    in_star
}

/// Pixels that hang together.
struct Groups {
    width_px: usize,
    /// Bright pixels, and the group of each where it was asked for.
    bright: BTreeMap<usize, Option<u32>>,
    last: u32,
}

impl Groups {
    fn of(deviations: &Deviations) -> Self {
        let bright = deviations.values.iter().enumerate().filter(|(_, value)| **value > TRACK_SIGMAS).map(|(index, _)| (index, None));
        Self { width_px: deviations.width_px, bright: bright.collect(), last: 0 }
    }

    /// The number of the group of a bright pixel.
    fn of_pixel(&mut self, index: usize) -> u32 {
        if let Some(Some(group)) = self.bright.get(&index) {
            return *group;
        }
        self.last += 1;
        let mut open = vec![index];
        while let Some(next) = open.pop() {
            let Some(group) = self.bright.get_mut(&next).filter(|group| group.is_none()) else { continue };
            *group = Some(self.last);
            open.extend(square(next, self.width_px));
        }
        self.last
    }
}

/// A pixel and its eight neighbours.
pub(super) fn square(index: usize, width_px: usize) -> impl Iterator<Item = usize> {
    [-1_isize, 0, 1].into_iter().flat_map(move |row| {
        [-1, 0, 1].into_iter().filter_map(move |column| index.checked_add_signed(row * width_px.cast_signed() + column))
    })
}
