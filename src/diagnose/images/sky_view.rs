//! Where the sky of a frame lies, and what shines there by the models of the registry.

use std::collections::BTreeMap;

use super::expected_stars::StarMeasurement;
use super::rows::{Parameter, Shown};
use super::sky_columns::Asked;
use super::sky_light::SkyLight;
use crate::effects::sky::airglow::Airglow;
use crate::effects::sky::glow::{Circumstances, Needs, SKY_GLOWS, SkyGlow};
use crate::statistics::median_in_place;

/// Fewer stars tell no zero point of a frame.
const MIN_ZERO: usize = 5;
/// A model whose light changes the sky by less than this share over any frame is not asked for.
const MIN_SHARE: f64 = 1e-6;

/// Where the cells of a frame's mesh lie in the sky.
#[derive(Clone, Debug, PartialEq)]
pub struct SkyView {
    /// Number of the frame in the recording.
    pub frame: usize,
    /// Directions of the cells, row by row, unit vectors in ICRS axes.
    pub directions: Vec<[f64; 3]>,
    /// Solid angle of a pixel in each, square arcseconds.
    pub pixel_arcsec2: Vec<f64>,
    /// Sun, Moon and zenith, as far as they are known.
    pub circumstances: Circumstances,
    /// Whether time is known.
    pub is_timed: bool,
}

impl SkyView {
    /// How far the middle of the mesh has moved, half-diagonals; nothing where the meshes are not alike.
    pub(super) fn moved(&self, other: &Self) -> Option<f64> {
        let angle = |a: &[f64; 3], b: &[f64; 3]| -> f64 {
            let square: f64 = a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum();
            2.0 * (0.5 * square.sqrt()).min(1.0).asin()
        };
        let (first, last) = (self.directions.first()?, self.directions.last()?);
        let middle = self.directions.len() / 2;
        let half = 0.5 * angle(first, last);
        (self.directions.len() == other.directions.len() && half > 0.0)
            .then(|| angle(&self.directions[middle], &other.directions[middle]) / half)
    }

    fn has(&self, needs: Needs) -> bool {
        match needs {
            Needs::Nothing => true,
            Needs::Time => self.is_timed && self.circumstances.sun.is_some(),
            Needs::Site => self.is_timed && self.circumstances.zenith.is_some(),
        }
    }
}

/// Counts of a star of V = 0 in every frame (by its place), and the faintest star that is seen.
fn zero_points(stars: &[StarMeasurement]) -> (BTreeMap<usize, f64>, f64) {
    let mut by_frame: BTreeMap<usize, Vec<f64>> = BTreeMap::new();
    for star in stars.iter().filter(|star| star.magnitude.is_finite() && star.magnitude < 90.0) {
        by_frame.entry(star.frame).or_default().push(star.flux_dn * 10.0_f64.powf(0.4 * star.magnitude));
    }
    let told = |(frame, mut own): (usize, Vec<f64>)| (own.len() >= MIN_ZERO).then(|| Some((frame, median_in_place(&mut own)?))).flatten();
    let faintest = stars.iter().map(|star| star.magnitude).filter(|magnitude| *magnitude < 90.0).fold(f64::NEG_INFINITY, f64::max);
    (by_frame.into_iter().filter_map(told).collect(), faintest)
}

/// The sky's sources that can be asked for, each with the light of its own model in every cell; and of the others why not.
pub(super) fn glows(light: &SkyLight, views: &[SkyView], stars: &[StarMeasurement]) -> (Vec<Asked>, Vec<(&'static str, String)>) {
    let (zero_dn, faintest_magnitude) = zero_points(stars);
    let by_number: BTreeMap<usize, &SkyView> = views.iter().map(|view| (view.frame, view)).collect();
    let (mut all, mut unasked) = (Vec::new(), Vec::new());
    for glow in SKY_GLOWS.iter().copied() {
        let is_known = light
            .frames
            .iter()
            .all(|frame| zero_dn.contains_key(&frame.place) && by_number.get(&frame.number).is_some_and(|view| view.has(glow.needs())));
        if !is_known {
            let what = match glow.needs() {
                Needs::Nothing => "",
                Needs::Time => " and the time",
                Needs::Site => ", time and site",
            };
            unasked.push((glow.id(), format!("it needs the attitude{what} of every frame, and stars of known magnitude in it")));
            continue;
        }
        let column = light.added(|frame, cell| {
            let (Some(view), Some(zero_dn)) = (by_number.get(&frame.number), zero_dn.get(&frame.place)) else { return 0.0 };
            zero_dn * brightness(glow, view, cell.number, faintest_magnitude)
        });
        let spread = column.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], value| [low.min(*value), high.max(*value)]);
        if spread[1] - spread[0] < MIN_SHARE {
            unasked.push((glow.id(), "its light is even here, or below the horizon".to_owned()));
            continue;
        }
        all.push(Asked {
            id: glow.id(),
            follows: if glow.id() == Airglow.id() { "zenith" } else { "field-map" },
            columns: vec![(Parameter { name: "relative", unit: "", shown: Shown::Same }, column)],
            sign: Some(1.0),
            is_shared: true,
            corner: None,
        });
    }
    (all, unasked)
}

/// Stars of V = 0 that shine into a pixel of a cell, by the model with its typical parameters.
fn brightness(glow: &dyn SkyGlow, view: &SkyView, number: usize, faintest_magnitude: f64) -> f64 {
    let (Some(direction), Some(arcsec2)) = (view.directions.get(number), view.pixel_arcsec2.get(number)) else { return 0.0 };
    let circumstances = Circumstances { faintest_magnitude, ..view.circumstances };
    if circumstances.is_below_horizon(*direction) {
        return 0.0;
    }
    let typical: Vec<f64> = glow.parameters().iter().map(|parameter| parameter.typical).collect();
    arcsec2 * glow.brightness(&typical, *direction, &circumstances)
}
