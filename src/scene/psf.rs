//! Point-spread function of a scene, over the field, for every colour and temperature.

use super::psf_table::MAX_BYTES;
use crate::effects::optics::sampled_psf::SampledImage;
use crate::effects::optics::tables::{AtlasBuilder, Grid, ImageKind, PixelResponse, image_kind};
use crate::effects::pixel::MAX_NODES;
use crate::effects::{ParameterSpec, StarState};

/// The widest Gaussian that the renderer spreads, px.
const MAX_SIGMA_PX: f64 = 50.0;

/// What kind of image, as the renderer needs it.
#[derive(Clone)]
pub enum PsfKind {
    /// A round Gaussian: the fast way.
    Gaussian,
    /// An elliptic Gaussian.
    Elliptic,
    /// From tables, worked out.
    Tables(&'static dyn ImageKind),
    /// From a table, given as an image.
    Sampled(SampledImage),
}

impl std::fmt::Debug for PsfKind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Gaussian => "Gaussian",
            Self::Elliptic => "Elliptic",
            Self::Tables(kind) => kind.id(),
            Self::Sampled(_) => "Sampled",
        })
    }
}

/// How the light of a star is spread.
#[derive(Clone, Debug)]
pub struct Psf {
    /// What kind of image.
    pub kind: PsfKind,
    /// The pixel's response where it is not even.
    pub pixel: PixelResponse,
    /// Width σ of the Gaussian that is as smooth as the narrowest image, px.
    pub smooth_px: f64,
    /// Width that stands for the image where a single one is asked for, px.
    pub typical_px: f64,
    /// How far light is followed in tables, px.
    pub reach_px: usize,
    /// Where tables are worked out.
    pub nodes: PsfNodes,
    /// How many of the detector's own pixels, on which light falls, stand along a pixel of the frame.
    pub own_per_px: usize,
    pub(super) specs: &'static [ParameterSpec],
    pub(super) parameters: Vec<f64>,
    pub(super) terms: Vec<PsfTerm>,
    pub(super) size_px: [usize; 2],
    /// Lowest and highest temperature of the exposures, K from their mean.
    pub(super) temperatures_k: [f64; 2],
}

/// A term of a parameter.
#[derive(Clone, Copy, Debug)]
pub(super) struct PsfTerm {
    pub(super) index: usize,
    pub(super) coefficient: f64,
    /// Powers of X, Y, colour and temperature.
    pub(super) powers: [i32; 4],
}

/// What the image of a star depends on.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Spot {
    /// Column.
    pub x_px: f64,
    /// Row.
    pub y_px: f64,
    /// B − V; where it is not known, 0.6 is taken.
    pub colour: Option<f64>,
    /// Temperature of the optics minus its mean over the exposures, K.
    pub temperature_offset_k: f64,
}

/// What tables follow besides the field.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Third {
    /// Nothing.
    Nothing,
    /// B − V.
    Colour,
    /// Temperature.
    Temperature,
}

/// A grid of places and colours or temperatures.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PsfNodes {
    /// Columns.
    pub columns: usize,
    /// Rows.
    pub rows: usize,
    /// What the third axis is.
    pub third: Third,
    /// Steps along it; 1 without one.
    pub depth: usize,
    /// Its ends: B − V, or K from the mean.
    pub range: [f64; 2],
}

impl PsfNodes {
    /// Bluest and reddest B − V.
    pub const COLOURS: [f64; 2] = [-0.4, 2.0];
    /// One table for all.
    pub const ONE: Self = Self { columns: 1, rows: 1, third: Third::Nothing, depth: 1, range: [0.0, 1.0] };

    /// How many there are.
    #[must_use]
    pub fn count(&self) -> usize {
        self.columns * self.rows * self.depth
    }
}

impl Psf {
    /// A round Gaussian, the same everywhere.
    #[must_use]
    pub fn gaussian(sigma_px: f64, size_px: [usize; 2]) -> Self {
        let kind = image_kind("gaussian");
        Self {
            kind: PsfKind::Gaussian,
            pixel: PixelResponse::default(),
            smooth_px: sigma_px,
            typical_px: sigma_px,
            reach_px: 0,
            nodes: PsfNodes::ONE,
            own_per_px: 1,
            specs: kind.map_or(&[], |kind| kind.parameters()),
            parameters: vec![sigma_px],
            terms: Vec::new(),
            size_px,
            temperatures_k: [0.0; 2],
        }
    }

    /// The same light on pixels of which so many stand along a pixel of the frame: places are still those of the frame, but lengths that are
    /// worked out are in the finer pixels.
    pub fn on_own_pixels(&self, own_per_px: usize) -> Result<Self, (&'static str, String, &'static str)> {
        let mut psf = Self { own_per_px: self.own_per_px * own_per_px, ..self.clone() };
        if let PsfKind::Sampled(image) = &mut psf.kind {
            if !image.points_per_px.is_multiple_of(own_per_px) {
                let remedy = "must be a multiple of camera.binning.factor, so that the detector's own pixels have whole points";
                return Err(("image_points_per_px", image.points_per_px.to_string(), remedy));
            }
            image.points_per_px /= own_per_px;
        }
        let finer = own_per_px as f64;
        (psf.smooth_px, psf.typical_px) = (finer * psf.smooth_px, finer * psf.typical_px);
        psf.reach_px *= own_per_px;
        let is_gaussian = matches!(psf.kind, PsfKind::Gaussian | PsfKind::Elliptic);
        if is_gaussian && own_per_px > 1 && psf.widest_px() > MAX_SIGMA_PX {
            let remedy = "of the detector's own pixels is more than the 50 that a Gaussian may have: choose a smaller width or camera.binning.factor";
            return Err(("sigma_px", psf.widest_px().to_string(), remedy));
        }
        psf.check_tables()?;
        Ok(psf)
    }

    /// The parameters of a star's image.
    #[must_use]
    pub fn parameters_at(&self, spot: &Spot) -> Vec<f64> {
        let half = 0.5 * self.size_px[0] as f64;
        let offset = |place: f64, size: usize| (place - 0.5 * (size as f64 - 1.0)) / half;
        let colour = spot.colour.map_or(0.0, |colour| colour - StarState::REFERENCE_COLOUR);
        let at = [offset(spot.x_px, self.size_px[0]), offset(spot.y_px, self.size_px[1]), colour, spot.temperature_offset_k];
        let mut values = self.parameters.clone();
        for term in &self.terms {
            values[term.index] += term.coefficient * (0..4).map(|axis| at[axis].powi(term.powers[axis])).product::<f64>();
        }
        for (value, spec) in values.iter_mut().zip(self.specs) {
            *value = value.clamp(spec.range.0, spec.range.1);
            if spec.unit == "px" {
                *value *= self.own_per_px as f64;
            }
        }
        values
    }

    /// For what a table is worked out.
    #[must_use]
    pub fn node(&self, index: usize) -> Spot {
        let PsfNodes { columns, rows, third, depth, range: [low, high] } = self.nodes;
        let along = |k: usize, count: usize, size: usize| match count {
            1 => 0.5 * (size as f64 - 1.0),
            _ => (size as f64) * k as f64 / (count - 1) as f64 - 0.5,
        };
        let at = low + (high - low) * (index / (columns * rows)) as f64 / (depth.max(2) - 1) as f64;
        Spot {
            x_px: along(index % columns, columns, self.size_px[0]),
            y_px: along(index / columns % rows, rows, self.size_px[1]),
            colour: (third == Third::Colour).then_some(at),
            temperature_offset_k: if third == Third::Temperature { at } else { 0.0 },
        }
    }

    /// The tables that a star mixes, and their weights, which add up to 1; those without weight stand last.
    #[must_use]
    pub fn mixture(&self, spot: &Spot) -> [(u32, f32); MAX_NODES] {
        let split = |share: f64, count: usize| -> [(usize, f64); 2] {
            if count == 1 {
                return [(0, 1.0), (0, 0.0)];
            }
            let place = share.clamp(0.0, 1.0) * (count - 1) as f64;
            let first = (place as usize).min(count - 2);
            [(first, 1.0 - (place - first as f64)), (first + 1, place - first as f64)]
        };
        let PsfNodes { columns, rows, third, depth, range: [low, high] } = self.nodes;
        let at = match third {
            Third::Nothing => low,
            Third::Colour => spot.colour.unwrap_or(StarState::REFERENCE_COLOUR),
            Third::Temperature => spot.temperature_offset_k,
        };
        let across = split((spot.x_px + 0.5) / self.size_px[0] as f64, columns);
        let down = split((spot.y_px + 0.5) / self.size_px[1] as f64, rows);
        let deep = split((at - low) / (high - low), depth);
        let mut mixture = [(0, 0.0); MAX_NODES];
        let mut used = 0;
        for (layer, by_layer) in deep {
            for (row, by_row) in down {
                for (column, by_column) in across {
                    let weight = (by_layer * by_row * by_column) as f32;
                    if weight != 0.0 {
                        mixture[used] = (((layer * rows + row) * columns + column) as u32, weight);
                        used += 1;
                    }
                }
            }
        }
        mixture
    }
}

impl Psf {
    /// Works out widths and reach, and checks that the tables are not too many.
    pub(super) fn measure(&mut self, reach_px: Option<usize>) -> Result<(), (&'static str, String, &'static str)> {
        let widths = |width: &dyn Fn(&[f64]) -> f64| self.everywhere().map(|p| width(&p)).fold(f64::INFINITY, f64::min);
        let middle = &self.parameters;
        let (smooth_px, typical_px, usual) = match &self.kind {
            PsfKind::Gaussian => (widths(&|p| p[0]), middle[0], 1),
            PsfKind::Elliptic => (widths(&|p| p[0].min(p[1])), (middle[0] * middle[1]).sqrt(), 1),
            PsfKind::Tables(kind) => (widths(&|p| kind.smooth_px(p)), kind.smooth_px(middle), kind.reach_px(middle)),
            PsfKind::Sampled(image) => (image.smooth_px(), 2.0 * image.smooth_px(), image.reach_px()),
        };
        let reach = reach_px.unwrap_or(usual);
        if !(1..=120).contains(&reach) {
            return Err(("reach_px", reach.to_string(), "must lie between 1 and 120"));
        }
        (self.smooth_px, self.typical_px, self.reach_px) = (smooth_px, typical_px.max(0.2), reach);
        self.check_tables()
    }

    /// Whether tables fit a buffer.
    fn check_tables(&self) -> Result<(), (&'static str, String, &'static str)> {
        let reach = self.reach_px;
        if let Some(grid) = self.grid()
            && AtlasBuilder::new(grid, reach).bytes(self.nodes.count()) + 64 > MAX_BYTES
        {
            let value = format!("{} tables of {} px", self.nodes.count(), 2 * reach + 1);
            return Err(("field_nodes", value, "are more than 128 MiB: choose fewer field_nodes or depth_nodes or a smaller reach_px"));
        }
        Ok(())
    }

    /// The parameters at places all over the field, in three colours, at the lowest and the highest temperature.
    fn everywhere(&self) -> impl Iterator<Item = Vec<f64>> {
        (0..150).map(|i| {
            let [width, height] = self.size_px;
            let place = |k: usize, size: usize| size as f64 * k as f64 / 4.0 - 0.5;
            let [blue, red] = PsfNodes::COLOURS;
            let colour = Some(blue + (red - blue) * (i / 25 % 3) as f64 / 2.0);
            let temperature_offset_k = self.temperatures_k[i / 75];
            self.parameters_at(&Spot { x_px: place(i % 5, width), y_px: place(i / 5 % 5, height), colour, temperature_offset_k })
        })
    }

    /// The largest width σ of Gaussians over the field, for all colours and temperatures, px.
    #[must_use]
    pub fn widest_px(&self) -> f64 {
        let width = |p: Vec<f64>| match self.kind {
            PsfKind::Gaussian => p[0],
            PsfKind::Elliptic => p[0].max(p[1]),
            PsfKind::Tables(_) | PsfKind::Sampled(_) => self.typical_px,
        };
        self.everywhere().map(width).fold(self.typical_px, f64::max)
    }

    /// The grid on which tables are worked out; `None` where there are none.
    #[must_use]
    pub fn grid(&self) -> Option<Grid> {
        match &self.kind {
            PsfKind::Gaussian | PsfKind::Elliptic => None,
            PsfKind::Tables(_) => Some(Grid::new(self.smooth_px, self.reach_px)),
            PsfKind::Sampled(image) => Some(image.grid(self.reach_px).0),
        }
    }
}
