//! Zero points of the frames against each other, and what is ordinary of them: the light of stars and sky, exposure times taken off.

use std::collections::BTreeMap;

use super::expected_stars::StarMeasurement;
use super::row_fit::RowFit;
use super::rows::Rows;
use crate::diagnose::channels::Channel;
use crate::pixel_statistics::PixelStatistics;
use crate::statistics::median;

/// From frame to frame the light differs by so much anyway, and a frame that differs by less is no finding, whatever its significance; magnitudes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Steady {
    pub(super) scatter_mag: f64,
    pub(super) least_mag: f64,
    pub(super) has_clouds: bool,
}

/// Scatter of the transparency of a clear night, magnitudes.
pub(super) const CLEAR_NIGHT_MAG: f64 = 0.02;
/// Through air.
const THROUGH_AIR: Steady = Steady { scatter_mag: CLEAR_NIGHT_MAG, least_mag: 0.08, has_clouds: true };
/// Where there is no air the shutter alone differs.
const IN_SPACE: Steady = Steady { scatter_mag: 0.005, least_mag: 0.02, has_clouds: false };

impl Steady {
    /// As it is under this air, or without any.
    pub(super) fn under(air: &Air) -> Self {
        if air.is_there { THROUGH_AIR } else { IN_SPACE }
    }
}

/// A frame's zero point less that of the others.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Level {
    pub(super) frame: usize,
    /// Fainter is positive, magnitudes.
    pub(super) stars: f64,
    pub(super) sigma: f64,
    /// The same of the sky.
    pub(super) sky: Option<f64>,
    /// Mean air mass of its stars, as its zero point weighs them.
    pub(super) airmass: Option<f64>,
}

/// The air above the camera.
#[derive(Clone, Debug, Default)]
pub(super) struct Air {
    /// Whether there is any.
    pub(super) is_there: bool,
    /// Air mass of every image, by the place of its frame among those that are tested and the number of its star; empty where it is not known.
    pub(super) mass: BTreeMap<(usize, usize), f64>,
}

impl Air {
    /// As the stars tell it.
    pub(super) fn of(stars: &[StarMeasurement], is_there: bool) -> Self {
        let mass = stars.iter().filter_map(|star| Some(((star.frame, star.star), star.image.airmass?))).collect();
        Self { is_there, mass }
    }

    /// Mean of every frame, weighted as a fit weighs its stars.
    fn mass_of_frames(&self, rows: &Rows, fit: &RowFit, kind: usize) -> BTreeMap<usize, f64> {
        let mut sums: BTreeMap<usize, [f64; 2]> = BTreeMap::new();
        for (row, k) in rows.kinds[kind].rows.iter().zip(rows.ranges()[kind].clone()) {
            let Some(mass) = self.mass.get(&(row.frame, row.star)).filter(|_| fit.take[k]) else { continue };
            let weight = fit.weight(k) / (fit.noise[kind].variance(row) + fit.noise[kind].shared);
            let own = sums.entry(row.frame).or_default();
            *own = [own[0] + weight * mass, own[1] + weight];
        }
        sums.into_iter().map(|(frame, [sum, weight])| (frame, sum / weight)).collect()
    }
}

/// A frame among those that are tested: its number in the recording, and its exposure time where that is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct TestedFrame {
    pub(super) number: usize,
    pub(super) exposure_s: Option<f64>,
}

/// Zero points of the frames in a fit, exposure times taken off. A frame of which that is not known has none: it may have been exposed in any way.
pub(super) fn levels(
    rows: &Rows,
    fit: &RowFit,
    pixels: Option<&PixelStatistics>,
    (bias_dn, air): (Option<f64>, &Air),
    tested: &[TestedFrame],
) -> Vec<Level> {
    let Some(kind) = rows.kinds.iter().position(|kind| kind.channel == Channel::Flux) else { return Vec::new() };
    let sky_dn: BTreeMap<usize, f64> = pixels.iter().flat_map(|pixels| &pixels.by_frame).map(|own| (own.frame, own.level_dn)).collect();
    let airmass = air.mass_of_frames(rows, fit, kind);
    let magnitudes = |light: f64| -2.5 * light.log10();
    let told: Vec<Level> = fit.frame_levels[kind]
        .iter()
        .filter_map(|(place, [stars, sigma])| {
            let TestedFrame { number: frame, exposure_s } = *tested.get(*place)?;
            let by_time = exposure_s.filter(|time| *time > 0.0).map(magnitudes)?;
            let sky = bias_dn
                .zip(sky_dn.get(&frame))
                .map(|(bias, level_dn)| level_dn - bias)
                .filter(|sky| *sky > 0.0)
                .map(|sky| magnitudes(sky) - by_time);
            Some(Level { frame, stars: stars - by_time, sigma: *sigma, sky, airmass: airmass.get(place).copied() })
        })
        .collect();
    let middle = median(&told.iter().map(|level| level.stars).collect::<Vec<_>>()).unwrap_or(0.0);
    let sky = median(&told.iter().filter_map(|level| level.sky).collect::<Vec<_>>()).unwrap_or(0.0);
    told.into_iter().map(|level| Level { stars: level.stars - middle, sky: level.sky.map(|own| own - sky), ..level }).collect()
}
