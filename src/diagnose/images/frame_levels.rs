//! Zero points of the frames against each other, and what is ordinary of them: the light of stars and sky, exposure times taken off.

use std::collections::BTreeMap;

use super::expected_stars::StarMeasurement;
use super::judge::Judged;
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

/// The transparency of a clear night.
const THROUGH_AIR: Steady = Steady { scatter_mag: 0.02, least_mag: 0.08, has_clouds: true };
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
    /// Mean air mass of its stars.
    pub(super) airmass: Option<f64>,
}

/// The air above the camera.
#[derive(Clone, Debug, Default)]
pub(super) struct Air {
    /// Whether there is any.
    pub(super) is_there: bool,
    /// Mean air mass of the stars of every frame, by its place among those that are tested; empty where it is not known.
    pub(super) mass_of_frame: BTreeMap<usize, f64>,
}

impl Air {
    /// As the stars tell it.
    pub(super) fn of(stars: &[StarMeasurement], is_there: bool) -> Self {
        let mut sums: BTreeMap<usize, [f64; 2]> = BTreeMap::new();
        for (frame, airmass) in stars.iter().filter_map(|star| Some((star.frame, star.image.airmass?))) {
            let own = sums.entry(frame).or_default();
            *own = [own[0] + airmass, own[1] + 1.0];
        }
        Self { is_there, mass_of_frame: sums.into_iter().map(|(frame, [sum, count])| (frame, sum / count)).collect() }
    }
}

/// A frame among those that are tested: its number in the recording, and its exposure time where that is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct TestedFrame {
    pub(super) number: usize,
    pub(super) exposure_s: Option<f64>,
}

/// Zero points of the frames, exposure times taken off. A frame of which that is not known has none: it may have been exposed in any way.
pub(super) fn levels(
    judged: &Judged,
    pixels: Option<&PixelStatistics>,
    (bias_dn, airmass): (Option<f64>, &BTreeMap<usize, f64>),
    tested: &[TestedFrame],
) -> Vec<Level> {
    let Some(kind) = judged.rows.kinds.iter().position(|kind| kind.channel == Channel::Flux) else { return Vec::new() };
    let sky_dn: BTreeMap<usize, f64> = pixels.iter().flat_map(|pixels| &pixels.by_frame).map(|own| (own.frame, own.level_dn)).collect();
    let magnitudes = |light: f64| -2.5 * light.log10();
    let told: Vec<Level> = judged.standing().frame_levels[kind]
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
