//! The sky between the stars as numbers that effects change linearly: the level of every cell of the mesh against that of its frame.
//!
//! Where the bias is known the number is ln(b/B), b the light of the cell and B that of its frame: a loss of light a·ρ² makes −ln(1 − a·ρ²) less of it,
//! which is just what it adds to the magnitudes of stars. Light that is added, g·S, makes g·S over the logarithmic mean of the light with it and without.
//! Of skies that hardly differ the logarithm is that of P, what all frames together have in the cell, and the rest is taken to first order:
//! ln P + (b/B − P)/P. So slopes of the skies stay slopes: the logarithm of each would leave the mean of their squares in all. Of a sky too faint for
//! logarithms cell by cell P is what all frames have at the cell's radius. Where the bias is not known, or the sky is hardly above it, the number is the difference of the levels.
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
/// Skies hardly differ where no cell's share of the light is off by more from what all frames have there, relative to that.
const MAX_DIFFERENCE: f64 = 0.2;
/// Frames whose common stars have moved by less (half-diagonals, the median) look at one field.
const SAME_FIELD: f64 = 0.25;
/// Fewer common stars say that the fields are different ones.
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
    /// So many times as much changes light the number that all frames have in this cell.
    pub(super) in_all: f64,
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
    /// Logarithms to first order about the share of the light in a cell, by the size of the frame and the number of the cell.
    AboutCells(BTreeMap<([usize; 2], usize), f64>),
    /// About the share of the light at a radius: coefficients of ρ⁰, ρ², ρ⁴ and ρ⁶.
    AboutRadius([f64; 4]),
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
            Some(black_dn) if meshes.iter().all(is_bright) => light_of_cells(&meshes, black_dn).map_or(Scale::Logarithm, Scale::AboutCells),
            Some(black_dn) => radial_light(&meshes, black_dn).map_or(Scale::Difference, Scale::AboutRadius),
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
                let about = |share: f64| share.ln() + own_dn / light_dn / share - 1.0;
                let (value, unit_dn, in_all) = match &scale {
                    Scale::Difference => (own_dn - light_dn, 1.0, 1.0),
                    Scale::Logarithm => ((own_dn / light_dn).ln(), logarithmic_mean(own_dn, light_dn), 1.0),
                    Scale::AboutCells(shares) => {
                        let share = shares[&(mesh.size_px, number)];
                        (about(share), share * light_dn, share / logarithmic_mean(share, 1.0))
                    }
                    Scale::AboutRadius(shares) => {
                        let share = share_at(shares, cell.at);
                        (about(share), share * light_dn, 1.0)
                    }
                };
                let scale_dn = if matches!(scale, Scale::Logarithm) { own_dn } else { unit_dn };
                light.cells.push(Cell { frame, number, at: cell.at, value, sigma: cell.sigma_dn / scale_dn, unit_dn, in_all });
            }
        }
        light
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
        column.iter_mut().zip(&self.cells).for_each(|(light, cell)| *light /= cell.unit_dn);
        // What all frames have is in the light that the logarithm is taken of.
        let mut shared: BTreeMap<(u64, usize), [f64; 2]> = BTreeMap::new();
        let same = |cell: &Cell| (self.frames[cell.frame].half_px.to_bits(), cell.number);
        for (number, cell) in column.iter().zip(&self.cells) {
            let [sum, all] = shared.entry(same(cell)).or_default();
            *sum += number * cell.sigma.powi(-2);
            *all += cell.sigma.powi(-2);
        }
        for (number, cell) in column.iter_mut().zip(&self.cells) {
            let [sum, all] = shared[&same(cell)];
            *number += sum / all * (cell.in_all - 1.0);
        }
        column
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
                in_all: mean(&|k| self.cells[k].in_all),
            });
            for (joined, column) in joined.iter_mut().zip(columns) {
                joined.push(mean(&|k| column[k]));
            }
        }
        (light, joined)
    }

    /// Of every frame the field that it looks at, told by the places of the stars in it.
    pub(super) fn fields(&self, stars: &[StarMeasurement]) -> Vec<usize> {
        let mut by_frame: BTreeMap<usize, BTreeMap<usize, [f64; 2]>> = BTreeMap::new();
        for star in stars {
            by_frame.entry(star.frame).or_default().insert(star.star, star.image.at);
        }
        let none = BTreeMap::new();
        let mut first: Vec<usize> = Vec::new();
        let mut field_of = Vec::with_capacity(self.frames.len());
        for frame in &self.frames {
            let own = by_frame.get(&frame.place).unwrap_or(&none);
            let is_same = |other: &&usize| {
                let other = by_frame.get(other).unwrap_or(&none);
                let mut moved: Vec<f64> =
                    own.iter().filter_map(|(star, at)| other.get(star).map(|was| (at[0] - was[0]).hypot(at[1] - was[1]))).collect();
                moved.len() >= MIN_COMMON && median_in_place(&mut moved).is_some_and(|moved| moved < SAME_FIELD)
            };
            let known = first.iter().position(|other| is_same(&other));
            field_of.push(known.unwrap_or(first.len()));
            if known.is_none() {
                first.push(frame.place);
            }
        }
        field_of
    }
}

/// The light in each cell as a share of the level of its frame, of all frames together: the weighted mean. Nothing where the frames differ much.
fn light_of_cells(meshes: &[&SkyMesh], black_dn: f64) -> Option<BTreeMap<([usize; 2], usize), f64>> {
    let mut sums: BTreeMap<([usize; 2], usize), [f64; 2]> = BTreeMap::new();
    for mesh in meshes {
        let light_dn = mesh.level_dn - black_dn;
        for (number, cell) in mesh.cells.iter().enumerate() {
            let Some(cell) = cell else { continue };
            let weight = (light_dn / cell.sigma_dn).powi(2);
            let [sum, all] = sums.entry((mesh.size_px, number)).or_default();
            *sum += (cell.level_dn - black_dn) / light_dn * weight;
            *all += weight;
        }
    }
    let shares: BTreeMap<_, f64> = sums.into_iter().map(|(cell, [sum, all])| (cell, sum / all)).collect();
    let differs = |mesh: &SkyMesh| {
        let cells = mesh.cells.iter().enumerate().filter_map(|(number, cell)| Some((number, cell.as_ref()?)));
        let share = |level_dn: f64| (level_dn - black_dn) / (mesh.level_dn - black_dn);
        cells.map(|(number, cell)| share(cell.level_dn) / shares[&(mesh.size_px, number)] - 1.0).any(|off| off.abs() > MAX_DIFFERENCE)
    };
    (!meshes.iter().any(|mesh| differs(mesh))).then_some(shares)
}

/// The light at a radius as a share of the level of its frame, of all frames together by weighted least squares; nothing where a frame's level or the
/// share in any cell is not known to a twentieth, or the share is none that a lens leaves.
fn radial_light(meshes: &[&SkyMesh], black_dn: f64) -> Option<[f64; 4]> {
    let (mut matrix, mut right) = (nalgebra::Matrix4::zeros(), nalgebra::Vector4::zeros());
    for mesh in meshes {
        let light_dn = mesh.level_dn - black_dn;
        let mut weight_of_level = 0.0;
        for cell in mesh.cells.iter().flatten() {
            let (powers, weight) = (powers(cell.at), (light_dn / cell.sigma_dn).powi(2));
            matrix += powers * powers.transpose() * weight;
            right += powers * ((cell.level_dn - black_dn) / light_dn * weight);
            weight_of_level += cell.sigma_dn.powi(-2);
        }
        if light_dn * weight_of_level.sqrt() < MIN_SIGMAS {
            return None;
        }
    }
    let covariance = matrix.cholesky()?.inverse();
    let shares: [f64; 4] = (covariance * right).into();
    let is_known = |at: [f64; 2]| {
        let (powers, share) = (powers(at), share_at(&shares, at));
        let sigma = (powers.transpose() * covariance * powers)[0].sqrt();
        share > MIN_SHARE && share < MAX_SHARE && share > MIN_SIGMAS * sigma
    };
    meshes.iter().flat_map(|mesh| mesh.cells.iter().flatten()).all(|cell| is_known(cell.at)).then_some(shares)
}

/// ρ⁰, ρ², ρ⁴ and ρ⁶ of a place.
fn powers(at: [f64; 2]) -> nalgebra::Vector4<f64> {
    let radius2 = at[0] * at[0] + at[1] * at[1];
    nalgebra::Vector4::new(1.0, radius2, radius2.powi(2), radius2.powi(3))
}

/// The share of the light at a place, from the coefficients of its powers.
fn share_at(shares: &[f64; 4], at: [f64; 2]) -> f64 {
    nalgebra::Vector4::from(*shares).dot(&powers(at))
}

/// (a − b)/(ln a − ln b).
fn logarithmic_mean(a: f64, b: f64) -> f64 {
    let ratio = (a / b).ln();
    if ratio.abs() < 1e-4 { 0.5 * (a + b) } else { (a - b) / ratio }
}
