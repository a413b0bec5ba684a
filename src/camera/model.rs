//! The whole camera: the reference model, its projection, and every other displacement in force, with their derivatives.
//!
//! # The chain
//! A star's light is followed from both ends, and the two meet in the axes of the camera:
//!
//! ```text
//! catalogue ── Sky effects ──▶ apparent ── attitude ──▶ camera axes ◀── Camera effects ◀── projection⁻¹ ◀── Focal effects ── measured pixel
//! ```
//! Distortions are corrections at the MEASURED point ([`Segment::Focal`]), so the way from the pixel to the direction is explicit and the way
//! back is found by Newton's method. The corrections of several effects are all evaluated at the measured point, and add.
//!
//! # Parameters
//! One list: the six of the reference model ([`PARAMETER_NAMES`]), those that a wide-angle projection has beyond x0, y0 and f, then those of
//! the terms in the order of the registry. A parameter of a term goes by `effect-id.parameter`.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::{Camera, PARAMETER_COUNT, PARAMETER_NAMES, PARAMETER_UNITS, SkyChain, Term};
use crate::coordinates::{Apparent, CameraAxes, Direction, PixelPoint};
use crate::dual::{Jet, PARTIALS, Real, normalize};
use crate::effects::ids;
use crate::effects::optics::brown_conrady;
use crate::effects::{AnyDisplacement, Context, DISPLACEMENTS, Light, Observation, ParameterSpec, Segment, StarState, displacement};

/// The projection of the reference model.
const PINHOLE: &str = ids::PINHOLE;
/// The distortion of the reference model; it is part of every model and never a term.
const BROWN_CONRADY: &str = ids::BROWN_CONRADY;

/// A camera with every displacement in force.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(try_from = "Stored", into = "Stored")]
pub struct Model {
    camera: Camera,
    projection: Link,
    terms: Vec<Link>,
}

/// A model as files have it.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
struct Stored {
    camera: Camera,
    projection: Term,
    terms: Vec<Term>,
}

/// A place in the registry and parameters.
#[derive(Clone, Debug, PartialEq)]
struct Link {
    index: usize,
    parameters: Vec<f64>,
}

/// Why a model cannot be made.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[non_exhaustive]
pub enum ModelError {
    /// No such effect.
    #[error("there is no displacement {0:?}; `boresight effects` lists them")]
    Unknown(String),
    /// An effect of another kind.
    #[error("{0} cannot be a term of a camera's model: it is the projection, or part of the reference model")]
    NotATerm(String),
    /// An effect that is no projection.
    #[error("{0} is no projection")]
    NotAProjection(String),
    /// The number of parameters is wrong.
    #[error("{effect} has {expected} parameters, not {given}")]
    Count {
        /// The effect.
        effect: String,
        /// As many it has.
        expected: usize,
        /// As many there were.
        given: usize,
    },
}

impl Link {
    fn effect(&self) -> &'static dyn AnyDisplacement {
        DISPLACEMENTS[self.index]
    }
}

/// A parameter of a model.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct ModelParameter {
    /// x0, …, p2, or `effect-id.parameter`.
    pub name: String,
    /// Its unit.
    pub unit: &'static str,
    /// The id of the effect it belongs to; empty for the reference model.
    pub effect: &'static str,
    /// Its index among the effect's parameters.
    pub index: usize,
}

/// A number on which the chain can be evaluated: plain or dual.
trait Number: Real {
    fn displace(effect: &dyn AnyDisplacement, parameters: &[Self], light: Light<Self>, context: &Context) -> Light<Self>;
    fn ray(effect: &dyn AnyDisplacement, parameters: &[Self], light: Light<Self>) -> Option<[Self; 3]>;
}

impl Number for f64 {
    fn displace(effect: &dyn AnyDisplacement, parameters: &[Self], light: Light<Self>, context: &Context) -> Light<Self> {
        effect.displace(parameters, light, context)
    }
    fn ray(effect: &dyn AnyDisplacement, parameters: &[Self], light: Light<Self>) -> Option<[Self; 3]> {
        effect.ray(parameters, light)
    }
}

impl Number for Jet {
    fn displace(effect: &dyn AnyDisplacement, parameters: &[Self], light: Light<Self>, context: &Context) -> Light<Self> {
        effect.displace_jet(parameters, light, context)
    }
    fn ray(effect: &dyn AnyDisplacement, parameters: &[Self], light: Light<Self>) -> Option<[Self; 3]> {
        effect.ray_jet(parameters, light)
    }
}

/// A measured pixel as a direction in camera axes, with its derivatives.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct PixelRay {
    /// Unit vector.
    pub direction: [f64; 3],
    /// d(direction)/d(column, row), 1/px.
    pub by_pixel: [[f64; 2]; 3],
    /// d(direction)/d(parameter), in the order of the parameters asked for.
    pub by_parameter: Vec<[f64; 3]>,
}

impl From<Model> for Stored {
    fn from(model: Model) -> Self {
        let terms = model.terms().map(|(effect, parameters)| Term { effect: effect.to_owned(), parameters: parameters.to_vec() });
        let terms = terms.collect();
        let projection = Term { effect: model.projection().to_owned(), parameters: model.projection.parameters.clone() };
        Self { camera: model.camera, projection, terms }
    }
}

impl TryFrom<Stored> for Model {
    type Error = ModelError;

    fn try_from(stored: Stored) -> Result<Self, ModelError> {
        let mut model = Self::new(stored.camera).with_projection(&stored.projection.effect, &stored.projection.parameters)?;
        for term in &stored.terms {
            model.set(&term.effect, &term.parameters)?;
        }
        Ok(model)
    }
}

impl From<Camera> for Model {
    fn from(camera: Camera) -> Self {
        Self::new(camera)
    }
}

impl Model {
    /// The reference model.
    #[must_use]
    pub fn new(camera: Camera) -> Self {
        let index = position(PINHOLE).unwrap_or_default();
        Self { camera, projection: Link { index, parameters: Vec::new() }, terms: Vec::new() }
    }

    /// The same with another projection; `parameters` are those it has beyond x0, y0 and f.
    pub fn with_projection(mut self, id: &str, parameters: &[f64]) -> Result<Self, ModelError> {
        let index = position(id).ok_or_else(|| ModelError::Unknown(id.to_owned()))?;
        let effect = DISPLACEMENTS[index];
        if effect.segment() != Segment::Projection {
            return Err(ModelError::NotAProjection(id.to_owned()));
        }
        let expected = effect.parameters().len() - 3;
        if parameters.len() != expected {
            return Err(ModelError::Count { effect: id.to_owned(), expected, given: parameters.len() });
        }
        self.projection = Link { index, parameters: parameters.to_vec() };
        Ok(self)
    }

    /// The parameters of the reference model.
    #[must_use]
    pub fn camera(&self) -> &Camera {
        &self.camera
    }

    /// What the projection has beyond focal length and principal point.
    #[must_use]
    pub fn projection_parameters(&self) -> &[f64] {
        &self.projection.parameters
    }

    /// The projection's id.
    #[must_use]
    pub fn projection(&self) -> &'static str {
        self.projection.effect().id()
    }

    /// The effects in force besides the reference model, in the order of the registry, with their parameters.
    pub fn terms(&self) -> impl Iterator<Item = (&'static str, &[f64])> {
        self.terms.iter().map(|term| (term.effect().id(), term.parameters.as_slice()))
    }

    /// Puts an effect in force, or gives it other parameters.
    pub fn set(&mut self, id: &str, parameters: &[f64]) -> Result<(), ModelError> {
        let index = position(id).ok_or_else(|| ModelError::Unknown(id.to_owned()))?;
        let effect = DISPLACEMENTS[index];
        if effect.segment() == Segment::Projection || id == BROWN_CONRADY {
            return Err(ModelError::NotATerm(id.to_owned()));
        }
        let expected = effect.parameters().len();
        if parameters.len() != expected {
            return Err(ModelError::Count { effect: id.to_owned(), expected, given: parameters.len() });
        }
        let link = Link { index, parameters: parameters.to_vec() };
        match self.terms.binary_search_by_key(&index, |term| term.index) {
            Ok(place) => self.terms[place] = link,
            Err(place) => self.terms.insert(place, link),
        }
        Ok(())
    }

    /// Takes an effect out; it is as if it had never been in force.
    pub fn remove(&mut self, id: &str) {
        self.terms.retain(|term| term.effect().id() != id);
    }

    /// Whether nothing but the reference model (pinhole, k1, p1, p2) stands between the camera axes and the pixel.
    #[must_use]
    pub fn is_reference_behind_the_lens(&self) -> bool {
        self.projection() == PINHOLE && self.terms.iter().all(|term| term.effect().segment() == Segment::Sky)
    }

    /// Whether an effect is in force that changes within a pixel.
    #[must_use]
    pub fn changes_within_pixels(&self) -> bool {
        self.terms.iter().any(|term| term.effect().is_within_pixels())
    }

    /// All parameters.
    #[must_use]
    pub fn parameters(&self) -> Vec<ModelParameter> {
        let reference = (0..PARAMETER_COUNT).map(|index| ModelParameter {
            name: PARAMETER_NAMES[index].to_owned(),
            unit: PARAMETER_UNITS[index],
            effect: "",
            index,
        });
        let of = |effect: &'static dyn AnyDisplacement, index: usize, spec: &ParameterSpec| ModelParameter {
            name: format!("{}.{}", effect.id(), spec.name),
            unit: spec.unit,
            effect: effect.id(),
            index,
        };
        let projection = self.projection.effect();
        let own = projection.parameters().iter().enumerate().skip(3).map(move |(index, spec)| of(projection, index, spec));
        let terms = self.terms.iter().flat_map(move |term| {
            let effect = term.effect();
            effect.parameters().iter().enumerate().map(move |(index, spec)| of(effect, index, spec))
        });
        reference.chain(own).chain(terms).collect()
    }

    /// The values of [`Self::parameters`].
    #[must_use]
    pub fn values(&self) -> Vec<f64> {
        let own = self.projection.parameters.iter().chain(self.terms.iter().flat_map(|term| &term.parameters));
        self.camera.parameters().iter().chain(own).copied().collect()
    }

    /// Sets all parameters; as many as [`Self::values`] gives.
    ///
    /// # Panics
    /// If there are not as many.
    pub fn set_values(&mut self, values: &[f64]) {
        let (camera, mut rest) = values.split_at(PARAMETER_COUNT);
        self.camera = self.camera.with_parameters(std::array::from_fn(|k| camera[k]));
        for link in std::iter::once(&mut self.projection).chain(&mut self.terms) {
            let (own, left) = rest.split_at(link.parameters.len());
            link.parameters.copy_from_slice(own);
            rest = left;
        }
        assert!(rest.is_empty(), "{} values too many", rest.len());
    }

    /// Measured pixel → direction in camera axes (at the frame's own time). `None` where no direction falls on the point.
    #[must_use]
    pub fn direction(&self, point: PixelPoint, context: &Context) -> Option<Direction<CameraAxes>> {
        let xyz = self.backward(&self.values(), [point.x_px, point.y_px], context)?;
        xyz.iter().all(|c| c.is_finite()).then(|| Direction::along(xyz))
    }

    /// Direction in camera axes → measured pixel; `None` where the direction has no image.
    #[must_use]
    pub fn pixel(&self, direction: &Direction<CameraAxes>, context: &Context) -> Option<PixelPoint> {
        self.invert(&self.values(), direction.xyz, context).map(|[x_px, y_px]| PixelPoint { x_px, y_px })
    }

    /// Catalogue star → direction from which its light arrives: the Sky effects in force.
    #[must_use]
    pub fn apparent(&self, context: &Context) -> Direction<Apparent> {
        Direction::from_unit(self.forward(&self.values(), context))
    }

    /// The measured pixel's direction and its derivatives with respect to the pixel and to the parameters with these indices (into
    /// [`Self::parameters`]). Those of Sky effects have none here: see [`Self::apparent_columns`].
    #[must_use]
    pub fn seen(&self, values: &[f64], wanted: &[usize], pixel: [f64; 2], context: &Context) -> Option<PixelRay> {
        let mut jets = values.iter().map(|value| Jet::constant(*value)).collect::<Vec<_>>();
        let mut seen = PixelRay { direction: [0.0; 3], by_pixel: [[0.0; 2]; 3], by_parameter: vec![[0.0; 3]; wanted.len()] };
        let first_sky = self.first_sky_and_count();
        let is_behind = |index: usize| !(first_sky.0..first_sky.0 + first_sky.1).contains(&index);
        let behind: Vec<usize> = (0..wanted.len()).filter(|k| is_behind(wanted[*k])).collect();
        let mut left = behind.as_slice();
        let mut pixel_done = false;
        // The pixel and the first parameters in one pass, the others in passes of their own.
        while !pixel_done || !left.is_empty() {
            let room = if pixel_done { PARTIALS } else { PARTIALS - 2 };
            let (now, later) = left.split_at(left.len().min(room));
            for (partial, k) in now.iter().enumerate() {
                jets[wanted[*k]] = Jet::variable(values[wanted[*k]], partial);
            }
            let point = if pixel_done {
                pixel.map(Jet::constant)
            } else {
                [Jet::variable(pixel[0], PARTIALS - 2), Jet::variable(pixel[1], PARTIALS - 1)]
            };
            let jet = self.backward(&jets, point, context)?;
            for (partial, k) in now.iter().enumerate() {
                seen.by_parameter[*k] = jet.map(|component| component.partials[partial]);
                jets[wanted[*k]] = Jet::constant(values[wanted[*k]]);
            }
            if !pixel_done {
                seen.direction = jet.map(Real::value);
                seen.by_pixel = jet.map(|component| [component.partials[PARTIALS - 2], component.partials[PARTIALS - 1]]);
                pixel_done = true;
            }
            left = later;
        }
        seen.direction.iter().all(|c| c.is_finite()).then_some(seen)
    }

    /// The apparent direction and its derivatives with respect to the parameters with these indices; zero for those that act behind the lens.
    #[must_use]
    pub fn apparent_columns(&self, values: &[f64], wanted: &[usize], context: &Context) -> ([f64; 3], Vec<[f64; 3]>) {
        let mut columns = vec![[0.0; 3]; wanted.len()];
        let direction = self.forward(values, context);
        let (first, count) = self.first_sky_and_count();
        let sky: Vec<usize> = (0..wanted.len()).filter(|k| (first..first + count).contains(&wanted[*k])).collect();
        for now in sky.chunks(PARTIALS) {
            let mut jets = values.iter().map(|value| Jet::constant(*value)).collect::<Vec<_>>();
            for (partial, k) in now.iter().enumerate() {
                jets[wanted[*k]] = Jet::variable(values[wanted[*k]], partial);
            }
            let jet = self.forward(&jets, context);
            for (partial, k) in now.iter().enumerate() {
                columns[*k] = jet.map(|component| component.partials[partial]);
            }
        }
        (direction, columns)
    }

    /// Index of the first parameter of the Sky effects, and how many they have: the registry has them first.
    fn first_sky_and_count(&self) -> (usize, usize) {
        let sky = self.terms.iter().filter(|term| term.effect().segment() == Segment::Sky);
        (PARAMETER_COUNT + self.projection.parameters.len(), sky.map(|term| term.parameters.len()).sum())
    }

    /// Terms with the slice of the parameters that is theirs.
    fn split<'a, T>(&'a self, values: &'a [T]) -> impl DoubleEndedIterator<Item = (&'static dyn AnyDisplacement, &'a [T])> {
        let mut from = PARAMETER_COUNT + self.projection.parameters.len();
        let terms: Vec<_> = self
            .terms
            .iter()
            .map(|term| {
                let own = &values[from..from + term.parameters.len()];
                from += own.len();
                (term.effect(), own)
            })
            .collect();
        terms.into_iter()
    }

    fn forward<T: Number>(&self, values: &[T], context: &Context) -> [T; 3] {
        let mut light = Light::from(context.star.direction.map(T::constant));
        if self.terms.is_empty() {
            return light.direction;
        }
        for (effect, own) in self.split(values).filter(|(effect, _)| effect.segment() == Segment::Sky) {
            light = T::displace(effect, own, light, context);
        }
        light.direction
    }

    fn backward<T: Number>(&self, values: &[T], pixel_px: [T; 2], context: &Context) -> Option<[T; 3]> {
        let [x0, y0, f, k1, p1, p2] = std::array::from_fn(|k| values[k]);
        let point_px = [pixel_px[0] - x0, pixel_px[1] - y0];
        let mut ideal = brown_conrady::ideal_from_measured([k1, p1, p2], point_px);
        let zero = T::constant(0.0);
        let measured = Light { direction: [zero, zero, T::constant(1.0)], point_px, pixel_px, focal_length_px: f };
        let reference = self.is_reference_behind_the_lens();
        if !reference {
            for (effect, own) in self.split(values).filter(|(effect, _)| effect.segment() == Segment::Focal) {
                let corrected = T::displace(effect, own, measured, context).point_px;
                for axis in 0..2 {
                    ideal[axis] = ideal[axis] + (corrected[axis] - point_px[axis]);
                }
            }
        }
        if self.projection.parameters.is_empty() && self.projection() == PINHOLE {
            let direction = normalize([ideal[0], ideal[1], f]);
            return Some(if reference { direction } else { self.behind_the_lens(values, Light { direction, ..measured }, context) });
        }
        let mut own = vec![x0, y0, f];
        own.extend_from_slice(&values[PARAMETER_COUNT..PARAMETER_COUNT + self.projection.parameters.len()]);
        let ray = T::ray(self.projection.effect(), &own, Light { point_px: ideal, ..measured })?;
        Some(self.behind_the_lens(values, Light { direction: normalize(ray), ..measured }, context))
    }

    /// The Camera effects, from the one that the light meets last to the first.
    fn behind_the_lens<T: Number>(&self, values: &[T], mut light: Light<T>, context: &Context) -> [T; 3] {
        for (effect, own) in self.split(values).rev().filter(|(effect, _)| effect.segment() == Segment::Camera) {
            light = T::displace(effect, own, light, context);
        }
        light.direction
    }

    /// Newton's method on the pixel, from the place where the projection alone would put the direction.
    fn invert(&self, values: &[f64], direction: [f64; 3], context: &Context) -> Option<[f64; 2]> {
        const STEPS: usize = 60;
        let [x0, y0, f] = [values[0], values[1], values[2]];
        let mut own = vec![x0, y0, f];
        own.extend_from_slice(&self.projection.parameters);
        if self.projection() == PINHOLE && direction[2] <= 0.0 {
            return None;
        }
        let start = self.projection.effect().displace(&own, Light::from(direction), context).point_px;
        let constants: Vec<Jet> = values.iter().map(|value| Jet::constant(*value)).collect();
        let mut pixel = start;
        let mut last = f64::INFINITY;
        for _ in 0..STEPS {
            let variables = [Jet::variable(pixel[0], 0), Jet::variable(pixel[1], 1)];
            let reached = self.backward(&constants, variables, context)?;
            let error: [f64; 3] = std::array::from_fn(|axis| direction[axis] - reached[axis].value);
            let column = |k: usize| reached.map(|component| component.partials[k]);
            let (u, v) = (column(0), column(1));
            let product = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
            let (uu, uv, vv) = (product(u, u), product(u, v), product(v, v));
            let determinant = uu * vv - uv * uv;
            // Beyond a fold the image is turned over: (∂d/∂x × ∂d/∂y)·d changes its sign.
            let d = reached.map(Real::value);
            let turned = (u[1] * v[2] - u[2] * v[1]) * d[0] + (u[2] * v[0] - u[0] * v[2]) * d[1] + (u[0] * v[1] - u[1] * v[0]) * d[2];
            if determinant.is_nan() || determinant <= 0.0 || turned <= 0.0 {
                return None;
            }
            let (ue, ve) = (product(u, error), product(v, error));
            let step = [(vv * ue - uv * ve) / determinant, (uu * ve - uv * ue) / determinant];
            let size = step[0].hypot(step[1]);
            let [next_x, next_y] = [pixel[0] + step[0], pixel[1] + step[1]];
            pixel = [next_x, next_y];
            let length = (pixel[0] - x0).hypot(pixel[1] - y0).max(1.0);
            if size <= 8.0 * f64::EPSILON * length || (size < 1e-10 * length && size >= last) {
                let seen = self.backward(values, pixel, context)?;
                let left: f64 = (0..3).map(|axis| (direction[axis] - seen[axis]).powi(2)).sum();
                return (left < 1e-16).then_some(pixel);
            }
            last = size;
        }
        None
    }

    /// The chain of the Sky effects in force, for one exposure.
    #[must_use]
    pub fn sky_chain(&self, observation: Observation) -> SkyChain {
        let effects: Vec<(&str, Vec<f64>)> = self.terms().map(|(id, parameters)| (id, parameters.to_vec())).collect();
        SkyChain::with_parameters(observation, &effects)
    }

    /// A star of the reference colour in an exposure of this camera of which nothing else is known: for a map of the camera alone.
    #[must_use]
    pub fn reference_context(&self) -> Context {
        let star = StarState { direction: [0.0, 0.0, 1.0], colour: Some(StarState::REFERENCE_COLOUR), ..StarState::default() };
        Context::new(star, Observation::of_sensor(self.camera.width_px, self.camera.height_px))
    }
}

impl Model {
    /// Whether a point lies on the frame.
    #[must_use]
    pub fn contains(&self, point: PixelPoint) -> bool {
        self.camera.contains(point)
    }
}

/// The place of an effect in the registry.
fn position(id: &str) -> Option<usize> {
    displacement(id)?;
    DISPLACEMENTS.iter().position(|effect| effect.id() == id)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_terms_it_is_the_reference_camera() {
        let camera = Camera { k1: 3e-8, p1: 2e-7, p2: -1e-7, ..Camera::pinhole(1024, 768, 1500.0) };
        let model = Model::new(camera);
        let context = model.reference_context();
        for (x_px, y_px) in [(0.0, 0.0), (511.5, 383.5), (1000.0, 20.0)] {
            let point = PixelPoint { x_px, y_px };
            let direction = model.direction(point, &context).unwrap();
            assert!(direction.angle_rad(&camera.direction(point)) < 1e-15);
            let back = model.pixel(&direction, &context).unwrap();
            assert!((back.x_px - x_px).hypot(back.y_px - y_px) < 1e-9, "{back:?}");
        }
    }
}
