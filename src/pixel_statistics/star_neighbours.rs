//! The light of other stars in a star's image: which stars are near, and how much light of theirs a pixel has.

use super::sky_frame::StarDisc;

/// Width of the rings in which the image is averaged, px.
const BIN_PX: f64 = 0.25;
/// So many stars that stand alone tell the image; else it is held to be a Gaussian.
const MIN_ALONE: usize = 5;
/// The mean image of a frame's stars is not quite that of each: so much of a star's light may be left where it is taken off; and where a Gaussian stands in,
/// which has no wings.
const IMAGE_ERROR: f64 = 0.2;
const GAUSSIAN_ERROR: f64 = 0.5;

/// Stars by the cells of a coarse grid.
pub(super) struct Neighbours {
    cells: std::collections::BTreeMap<[i64; 2], Vec<usize>>,
    largest_px: f64,
}

impl Neighbours {
    const CELL_PX: f64 = 32.0;

    fn cell(at: f64) -> i64 {
        (at / Self::CELL_PX).floor() as i64
    }

    pub(super) fn of(stars: &[StarDisc]) -> Self {
        let mut cells: std::collections::BTreeMap<[i64; 2], Vec<usize>> = std::collections::BTreeMap::new();
        for (index, star) in stars.iter().enumerate() {
            cells.entry([Self::cell(star.x_px), Self::cell(star.y_px)]).or_default().push(index);
        }
        Self { cells, largest_px: stars.iter().map(|star| star.radius_px).fold(0.0, f64::max) }
    }

    /// The other stars that light something within `reach_px` of a star.
    pub(super) fn of_star(&self, stars: &[StarDisc], index: usize, reach_px: f64) -> Vec<usize> {
        let star = &stars[index];
        let reach = reach_px + self.largest_px;
        let span = |at: f64| Self::cell(at - reach)..=Self::cell(at + reach);
        let is_near = |other: &StarDisc| (other.x_px - star.x_px).hypot(other.y_px - star.y_px) < reach_px + other.radius_px;
        let cells = span(star.x_px).flat_map(|x| span(star.y_px).map(move |y| [x, y]));
        let of_cell = |cell: [i64; 2]| self.cells.get(&cell).into_iter().flatten().copied();
        cells.flat_map(of_cell).filter(|other| *other != index && is_near(&stars[*other])).collect()
    }
}

/// The mean image of a frame's stars by the distance from the centre: light of a pixel over that of the star.
pub(super) struct MeanImage {
    /// Sums of counts and of light, by rings.
    rings: Vec<[f64; 2]>,
    stars: usize,
    /// Width of the Gaussian that stands in where too few stars tell.
    sigma_px: f64,
}

impl MeanImage {
    /// Of no star yet. `reach_px`: beyond it there is no light.
    pub(super) fn new(sigma_px: f64, reach_px: f64) -> Self {
        Self { rings: vec![[0.0; 2]; (reach_px / BIN_PX).ceil() as usize], stars: 0, sigma_px }
    }

    /// Adds a star that stands alone: its counts above the sky at distances from its centre.
    pub(super) fn add(&mut self, flux_dn: f64, pixels: impl Iterator<Item = (f64, f64)>) {
        self.stars += 1;
        for (distance_px, counts) in pixels {
            if let Some(ring) = self.rings.get_mut((distance_px / BIN_PX) as usize) {
                *ring = [ring[0] + counts, ring[1] + flux_dn];
            }
        }
    }

    /// How far a star's light may differ from the image, relative to it.
    pub(super) fn error(&self) -> f64 {
        if self.stars < MIN_ALONE { GAUSSIAN_ERROR } else { IMAGE_ERROR }
    }

    /// Share of a star's light that a pixel at a distance has; nothing beyond where the image is told.
    pub(super) fn share(&self, distance_px: f64) -> Option<f64> {
        if distance_px >= self.rings.len() as f64 * BIN_PX {
            return None;
        }
        if self.stars < MIN_ALONE {
            let square = self.sigma_px * self.sigma_px;
            return Some((-0.5 * distance_px * distance_px / square).exp() / (std::f64::consts::TAU * square));
        }
        let of =
            |ring: usize| self.rings.get(ring).map_or(0.0, |[counts, light]| if *light > 0.0 { (counts / light).max(0.0) } else { 0.0 });
        // Rings have their mean in their middle.
        let at = (distance_px / BIN_PX - 0.5).max(0.0);
        let (ring, part) = (at as usize, at.fract());
        Some(of(ring) * (1.0 - part) + of(ring + 1) * part)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A winged image is told by stars at any place in their pixels; of few stars a Gaussian is taken.
    #[test]
    fn the_mean_image_is_that_of_the_stars() {
        let moffat = |r: f64| (1.0 + 0.5 * r * r).powf(-2.5) * 1.5 / (2.0 * std::f64::consts::PI);
        let mut mean = MeanImage::new(1.0, 8.0);
        for star in 0..40 {
            let at = [f64::from(star % 7) / 7.0, f64::from(star % 5) / 5.0];
            let distance = |k: i32| (f64::from(k % 17) - 8.0 - at[0]).hypot(f64::from(k / 17) - 8.0 - at[1]);
            let before = mean.share(3.0).unwrap();
            assert_eq!(star < 5, before == (-4.5_f64).exp() / std::f64::consts::TAU, "star {star}");
            mean.add(100.0, (0..17 * 17).map(|k| (distance(k), 100.0 * moffat(distance(k)))));
        }
        for distance in [1.5, 2.2, 3.0, 4.7, 6.1] {
            let ratio = mean.share(distance).unwrap() / moffat(distance);
            assert!((ratio - 1.0).abs() < 0.04, "{distance} px: {ratio}");
        }
        assert_eq!(mean.share(9.0), None);
    }
}
