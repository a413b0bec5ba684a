//! The sky between the stars as numbers that effects change linearly: the level of every cell of the mesh against that of its frame.
//!
//! Where the bias is known the number is ln(b/B), b the light of the cell and B that of its frame: a loss of light a·ρ² makes −ln(1 − a·ρ²) less of it,
//! which is just what it adds to the magnitudes of stars. The logarithm is that of P, what all frames together have at the cell's radius and in its
//! halves of the frame, and the rest is taken to first order: ln P + (b/B − P)/P. So slopes of the skies stay slopes, and a sky may be too faint for a logarithm cell
//! by cell. Of bright skies that differ much (under a Moon) the logarithm is taken cell by cell; light that is added, g·S, makes g·S over the logarithmic
//! mean of the light with it and without there. Where the bias is not known, or the sky is hardly above it, the number is the difference of the levels.
//!
//! Frames of one field share whatever the sky has there. They are joined, cell by cell, so that what is left are fields that differ in their sky.

use std::collections::BTreeMap;

use super::expected_stars::StarMeasurement;
use crate::pixel_statistics::SkyMesh;
use crate::statistics::{median, median_in_place};

/// Fewer cells of a frame tell no shape.
const MIN_CELLS: usize = 8;
/// A logarithm is taken of levels that are so many of their errors above the bias,
const MIN_SIGMAS: f64 = 20.0;
/// and at least this share of their frame's.
const MIN_SHARE: f64 = 0.05;
/// Light that all frames together have at a radius is taken for what a lens leaves up to this share of their levels.
const MAX_SHARE: f64 = 1.5;
/// Skies differ much where a cell is off by more from what all frames have, relative to that.
const MAX_DIFFERENCE: f64 = 0.2;
/// Noise may make so many standard errors of that.
const NOISE_SIGMAS: f64 = 4.0;
/// Frames whose common stars have moved by less (half-diagonals, the median) look at one field.
const SAME_FIELD: f64 = 0.25;
/// Frames that have so many stars have as many in common where they look at one field.
const MIN_COMMON: usize = 3;

/// What is known of a frame, or of the joined frames of a field.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct SkyFrame {
    /// Its number in the recording.
    pub(super) number: usize,
    /// Its place among the frames.
    pub(super) place: usize,
    pub(super) exposure_s: Option<f64>,
    /// Light of the sky, DN: its level above the bias where that is known.
    pub(super) light_dn: f64,
    /// Half the diagonal, px.
    pub(super) half_px: f64,
    /// Right and lower edge of the frame, half-diagonals.
    pub(super) edge: [f64; 2],
}

/// The sky in one cell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Cell {
    /// Number of its frame (or field) in [`SkyLight::frames`].
    pub(super) frame: usize,
    /// Number in the mesh.
    pub(super) number: usize,
    /// Place from the middle of the frame, half-diagonals.
    pub(super) at: [f64; 2],
    /// The number that is told, and its standard error.
    pub(super) value: f64,
    pub(super) sigma: f64,
    /// DN that change the number by one.
    pub(super) unit_dn: f64,
}

/// The sky of a recording.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct SkyLight {
    pub(super) frames: Vec<SkyFrame>,
    /// Frame after frame.
    pub(super) cells: Vec<Cell>,
    /// Whether the numbers are shares of the light.
    pub(super) is_relative: bool,
}

/// What the numbers are.
enum Scale {
    /// Differences of levels.
    Difference,
    /// Logarithms of shares.
    Logarithm,
    /// Logarithms to first order about the share of the light that all frames have.
    About(Shares),
}

impl SkyLight {
    /// Of the frames that have places.
    pub(super) fn new(meshes: &[SkyMesh], bias_dn: Option<f64>, places: &BTreeMap<usize, usize>) -> Self {
        let told = |mesh: &&SkyMesh| places.contains_key(&mesh.frame) && mesh.cells.iter().flatten().count() >= MIN_CELLS;
        let meshes: Vec<&SkyMesh> = meshes.iter().filter(told).collect();
        let black_dn = bias_dn.unwrap_or(0.0);
        let is_bright = |mesh: &&SkyMesh| {
            let light_dn = mesh.level_dn - black_dn;
            mesh.cells.iter().flatten().all(|cell| {
                let own_dn = cell.level_dn - black_dn;
                own_dn > MIN_SIGMAS * cell.sigma_dn && own_dn > MIN_SHARE * light_dn
            })
        };
        let scale = match bias_dn {
            None => Scale::Difference,
            Some(black_dn) => match shared_light(&meshes, black_dn) {
                Some((shares, difference)) if difference < MAX_DIFFERENCE => Scale::About(shares),
                _ if meshes.iter().all(is_bright) => Scale::Logarithm,
                found => found.map_or(Scale::Difference, |(shares, _)| Scale::About(shares)),
            },
        };
        let mut light = Self { is_relative: !matches!(scale, Scale::Difference), ..Self::default() };
        for (frame, mesh) in meshes.into_iter().enumerate() {
            let light_dn = mesh.level_dn - black_dn;
            let half_px = mesh.half_diagonal_px();
            light.frames.push(SkyFrame {
                number: mesh.frame,
                place: places.get(&mesh.frame).copied().unwrap_or(0),
                exposure_s: mesh.exposure_s,
                light_dn,
                half_px,
                edge: mesh.size_px.map(|side| 0.5 * side as f64 / half_px),
            });
            for (number, cell) in mesh.cells.iter().enumerate() {
                let Some(cell) = cell else { continue };
                let own_dn = cell.level_dn - black_dn;
                let (value, unit_dn, scale_dn) = match &scale {
                    Scale::Difference => (own_dn - light_dn, 1.0, 1.0),
                    Scale::Logarithm => ((own_dn / light_dn).ln(), logarithmic_mean(own_dn, light_dn), own_dn),
                    Scale::About(shares) => {
                        let share = share_at(shares, cell.at);
                        (share.ln() + own_dn / light_dn / share - 1.0, share * light_dn, share * light_dn)
                    }
                };
                light.cells.push(Cell { frame, number, at: cell.at, value, sigma: cell.sigma_dn / scale_dn, unit_dn });
            }
        }
        light
    }

    /// The cells of a frame, by their places among all.
    pub(super) fn of_frame(&self, frame: usize) -> Vec<usize> {
        (0..self.cells.len()).filter(|k| self.cells[*k].frame == frame).collect()
    }

    /// A column over the cells from what a unit of a parameter adds to the number.
    pub(super) fn column(&self, of: impl Fn(&SkyFrame, &Cell) -> f64) -> Vec<f64> {
        self.cells.iter().map(|cell| of(&self.frames[cell.frame], cell)).collect()
    }

    /// A column of light that is added, from what a unit of a parameter adds in DN. The light counts from its median over the frame, since the level
    /// of the frame holds that.
    pub(super) fn added(&self, of_dn: impl Fn(&SkyFrame, &Cell) -> f64) -> Vec<f64> {
        let mut column = self.column(of_dn);
        for own in self.cells.chunk_by(|a, b| a.frame == b.frame).scan(0, |end, own| {
            *end += own.len();
            Some(*end - own.len()..*end)
        }) {
            let middle = median(&column[own.clone()]).unwrap_or(0.0);
            column[own].iter_mut().for_each(|light| *light -= middle);
        }
        column.iter().zip(&self.cells).map(|(light, cell)| light / cell.unit_dn).collect()
    }

    /// Frames of one field joined: weighted means of the same cells, the columns with them.
    pub(super) fn joined(&self, field_of: &[usize], columns: &[Vec<f64>]) -> (Self, Vec<Vec<f64>>) {
        let mut members: BTreeMap<(usize, usize), Vec<usize>> = BTreeMap::new();
        for (k, cell) in self.cells.iter().enumerate() {
            members.entry((field_of[cell.frame], cell.number)).or_default().push(k);
        }
        let fields: std::collections::BTreeSet<usize> = field_of.iter().copied().collect();
        let first_of = |field: usize| field_of.iter().position(|own| *own == field).unwrap_or(0);
        let mut light = Self { frames: fields.iter().map(|field| self.frames[first_of(*field)].clone()).collect(), ..self.clone() };
        light.cells.clear();
        let mut joined = vec![Vec::with_capacity(members.len()); columns.len()];
        let place: BTreeMap<usize, usize> = fields.into_iter().zip(0..).collect();
        for ((field, number), own) in members {
            let weight = |k: usize| self.cells[k].sigma.powi(-2);
            let total: f64 = own.iter().map(|k| weight(*k)).sum();
            let mean = |of: &dyn Fn(usize) -> f64| own.iter().map(|k| of(*k) * weight(*k)).sum::<f64>() / total;
            light.cells.push(Cell {
                frame: place[&field],
                number,
                at: [0, 1].map(|axis| mean(&|k| self.cells[k].at[axis])),
                value: mean(&|k| self.cells[k].value),
                sigma: total.sqrt().recip(),
                unit_dn: mean(&|k| self.cells[k].unit_dn),
            });
            for (joined, column) in joined.iter_mut().zip(columns) {
                joined.push(mean(&|k| column[k]));
            }
        }
        (light, joined)
    }

    /// Of every frame the field that it looks at, told by the places of the stars in it; of frames with too few stars by their attitudes. Frames of which
    /// neither is known join the first field: what they share is then not held for the camera's. `moved`: how far two frames, by their numbers, are apart by
    /// their attitudes, half-diagonals.
    pub(super) fn fields(&self, stars: &[StarMeasurement], moved: &dyn Fn([usize; 2]) -> Option<f64>) -> Vec<usize> {
        let mut by_frame: BTreeMap<usize, BTreeMap<usize, [f64; 2]>> = BTreeMap::new();
        for star in stars {
            by_frame.entry(star.frame).or_default().insert(star.star, star.image.at);
        }
        let none = BTreeMap::new();
        let mut first: Vec<&SkyFrame> = Vec::new();
        let mut field_of = Vec::with_capacity(self.frames.len());
        for frame in &self.frames {
            let own = by_frame.get(&frame.place).unwrap_or(&none);
            let is_same = |other: &&&SkyFrame| {
                let numbers = [frame.number, other.number];
                let other = by_frame.get(&other.place).unwrap_or(&none);
                if own.len().min(other.len()) < MIN_COMMON {
                    // A frame of which nothing is known joins the first field; one of which something is known does not join such a frame.
                    return moved(numbers).map_or(own.len() < MIN_COMMON, |moved| moved < SAME_FIELD);
                }
                let mut moved: Vec<f64> =
                    own.iter().filter_map(|(star, at)| other.get(star).map(|was| (at[0] - was[0]).hypot(at[1] - was[1]))).collect();
                moved.len() >= MIN_COMMON && median_in_place(&mut moved).is_some_and(|moved| moved < SAME_FIELD)
            };
            let known = first.iter().position(|other| is_same(&other));
            field_of.push(known.unwrap_or(first.len()));
            if known.is_none() {
                first.push(frame);
            }
        }
        field_of
    }
}

/// The light that all frames together have in a cell, as a share of the level of their frames: coefficients of what [`terms`] gives.
type Shares = [f64; TERMS];
/// How many, and how many of them are the camera's: the others are slopes of the skies.
const TERMS: usize = 8;
const OF_CAMERA: usize = 6;
type Terms = nalgebra::SVector<f64, TERMS>;

/// The light that all frames together have, by weighted least squares, and by how much any cell is off, relative to it; nothing where a frame's level or the
/// share in any cell is not known to a twentieth, or the share is none that a lens leaves.
fn shared_light(meshes: &[&SkyMesh], black_dn: f64) -> Option<(Shares, f64)> {
    let (mut matrix, mut right) = (nalgebra::SMatrix::<f64, TERMS, TERMS>::zeros(), Terms::zeros());
    for mesh in meshes {
        let light_dn = mesh.level_dn - black_dn;
        let mut weight_of_level = 0.0;
        for cell in mesh.cells.iter().flatten() {
            let (terms, weight) = (terms(cell.at), (light_dn / cell.sigma_dn).powi(2));
            matrix += terms * terms.transpose() * weight;
            right += terms * ((cell.level_dn - black_dn) / light_dn * weight);
            weight_of_level += cell.sigma_dn.powi(-2);
        }
        if light_dn * weight_of_level.sqrt() < MIN_SIGMAS {
            return None;
        }
    }
    let covariance = matrix.cholesky()?.inverse();
    let shares: Shares = (covariance * right).into();
    let mut difference = 0.0_f64;
    for mesh in meshes {
        for cell in mesh.cells.iter().flatten() {
            let (own, share) = (of_camera(cell.at), share_at(&shares, cell.at));
            let sigma = (own.transpose() * covariance * own)[0].sqrt();
            if share < MIN_SHARE.max(MIN_SIGMAS * sigma) || share > MAX_SHARE {
                return None;
            }
            let off = ((cell.level_dn - black_dn) / (mesh.level_dn - black_dn) / share - 1.0).abs();
            // What the noise makes is no difference of the skies.
            difference = difference.max(off - NOISE_SIGMAS * cell.sigma_dn / (mesh.level_dn - black_dn) / share);
        }
    }
    Some((shares, difference))
}

/// Even powers of the radius to the sixth, the lower and the right half, and slopes.
fn terms(at: [f64; 2]) -> Terms {
    let radius2 = at[0] * at[0] + at[1] * at[1];
    let [right, lower] = at.map(|along| if along > 0.0 { 0.5 } else { -0.5 });
    Terms::from([1.0, radius2, radius2.powi(2), radius2.powi(3), right, lower, at[0], at[1]])
}

/// What of that the camera does.
fn of_camera(at: [f64; 2]) -> Terms {
    let mut all = terms(at);
    all.rows_mut(OF_CAMERA, TERMS - OF_CAMERA).fill(0.0);
    all
}

/// The share of the light that the camera leaves at a place.
fn share_at(shares: &Shares, at: [f64; 2]) -> f64 {
    Terms::from(*shares).dot(&of_camera(at))
}

/// (a − b)/(ln a − ln b).
fn logarithmic_mean(a: f64, b: f64) -> f64 {
    let ratio = (a / b).ln();
    if ratio.abs() < 1e-4 { 0.5 * (a + b) } else { (a - b) / ratio }
}
