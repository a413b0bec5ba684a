//! What a displacement is, and the registry of all of them.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Facts, Rendering, StarImage};
use crate::dual::{Jet, Real};

/// A parameter of an effect.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ParameterSpec {
    /// Its name in files, with the unit where it has one.
    pub name: &'static str,
    /// Its unit, empty for a pure number.
    pub unit: &'static str,
    /// The value a camera or a sky with this effect fully present has (1 for an amplitude); where that is not a fixed
    /// number, a typical one.
    pub typical: f64,
    /// The physical range; a value outside it is an error.
    pub range: (f64, f64),
}

/// A parameter that has to be searched for.
#[derive(Clone, Debug, PartialEq)]
pub struct Searched {
    /// Its index.
    pub parameter: usize,
    /// Values to try first, in rising order; between them the search is made finer.
    pub values: Vec<f64>,
    /// Whether it is fitted like the others once the search has come near.
    pub then_fitted: bool,
}

/// The sizes that nature has for an effect.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Natural {
    /// What is so long, in words.
    pub what: &'static str,
    /// Indices of the parameters: one for a number, several for the components of a vector.
    pub parameters: &'static [usize],
    /// The range of the number, or of the vector's length, in the unit of its components; the least length of a vector is 0.
    pub range: (f64, f64),
}

/// Where along the way of the light a displacement acts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Segment {
    /// On the direction, in ICRS axes, before the camera's attitude. `displace` takes the direction before to the direction after.
    Sky,
    /// On the direction, in camera axes, as a correction: `displace` takes the direction that the optics saw at the MEASURED point to the
    /// direction at the middle of the exposure of the middle row, which is when the frame's attitude is meant.
    Camera,
    /// The joint of the two: from a direction in camera axes to a point on the ideal focal plane, px from the corner.
    Projection,
    /// On the focal plane, as a correction: `displace` takes the MEASURED point to the point before the effect. The corrections of several
    /// effects are all evaluated at the measured point and add, so their order is of no account. The renderer inverts their sum.
    Focal,
}

/// A star's light along the chain.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Light<T> {
    /// Unit vector: ICRS axes in [`Segment::Sky`], camera axes from [`Segment::Camera`] on.
    pub direction: [T; 3],
    /// Point on the focal plane in px relative to the principal point; used in [`Segment::Focal`].
    pub point_px: [T; 2],
    /// The measured point in px of the frame as stored; used in [`Segment::Focal`] and [`Segment::Camera`].
    pub pixel_px: [T; 2],
    /// Focal length in px; used in [`Segment::Focal`].
    pub focal_length_px: T,
}

impl<T: Real> Light<T> {
    /// Light from a direction, before it meets the camera.
    pub fn from(direction: [T; 3]) -> Self {
        let zero = T::constant(0.0);
        Self { direction, point_px: [zero; 2], pixel_px: [zero; 2], focal_length_px: T::constant(1.0) }
    }
}

/// What is known of the star whose light it is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct StarState {
    /// Catalogue direction at the catalogue's epoch, ICRS unit vector.
    pub direction: [f64; 3],
    /// Epoch of that direction, Julian year (TDB).
    pub epoch_yr: f64,
    /// Proper motion east (times cos δ) and north, rad per Julian year; zero where unknown.
    pub proper_motion_rad_yr: [f64; 2],
    /// Parallax in radians; zero where unknown.
    pub parallax_rad: f64,
    /// V magnitude.
    pub magnitude: f64,
    /// B − V; `None` where unknown.
    pub colour: Option<f64>,
}

/// What is known of the exposure. What is `None` is not known, and effects that need it do not apply.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct Observation {
    /// Middle of the exposure, Julian year (TDB).
    pub epoch_yr: Option<f64>,
    /// Barycentric position of the camera, au, ICRS axes.
    pub position_au: Option<[f64; 3]>,
    /// Barycentric velocity of the camera, km/s, ICRS axes.
    pub velocity_km_s: Option<[f64; 3]>,
    /// Vector from the Sun to the camera, au, ICRS axes.
    pub sun_au: Option<[f64; 3]>,
    /// Unit vector to the zenith, ICRS axes.
    pub zenith: Option<[f64; 3]>,
    /// Whether the zenith is no more than a starting value, because the site or the time is not known: it must be fitted.
    pub zenith_is_guessed: bool,
    /// Refraction of the site's air.
    pub refraction: Option<RefractionConstants>,
    /// Rows of the rotation from ICRS axes to axes fixed to the Earth (z to the pole, x to the meridian of Greenwich).
    pub earth_from_icrs: Option<[[f64; 3]; 3]>,
    /// Time from the mean of the recording's frames, hours.
    pub time_offset_h: Option<f64>,
    /// Number of the frame in its recording minus the mean of the numbers.
    pub order_offset: Option<f64>,
    /// Temperature minus the mean of the recording's frames, K.
    pub temperature_offset_k: Option<f64>,
    /// Air pressure at the camera minus the mean of the recording's frames (telemetry `pressure_hpa` of a frame).
    pub pressure_offset_hpa: Option<f64>,
    /// Rotation of the camera in camera axes: the camera turns by rate × time.
    pub rate_rad_s: Option<[f64; 3]>,
    /// Length of the exposure.
    pub exposure_s: Option<f64>,
    /// The frame's sensor.
    pub sensor: Option<Sensor>,
}

/// What is known of the sensor.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Sensor {
    /// Columns.
    pub width_px: usize,
    /// Rows.
    pub height_px: usize,
    /// With a rolling shutter, how much later each row of a higher number is exposed (negative if the last row is read first); zero
    /// with a global one, absent where nobody says.
    pub line_time_s: Option<f64>,
    /// Whether the last row is read first, which is known even where the time from row to row is not.
    #[serde(default)]
    pub last_row_first: bool,
}

impl Sensor {
    /// Half the width, the unit of length of effects whose parameters are in px at the edge of the frame.
    #[must_use]
    pub fn half_width_px(&self) -> f64 {
        self.width_px as f64 / 2.0
    }

    /// The middle of the frame.
    #[must_use]
    pub fn middle_px(&self) -> [f64; 2] {
        [(self.width_px as f64 - 1.0) / 2.0, (self.height_px as f64 - 1.0) / 2.0]
    }
}

impl Observation {
    /// Of a camera of which nothing but the size of its frames is known.
    #[must_use]
    pub fn of_sensor(width_px: usize, height_px: usize) -> Self {
        Self { sensor: Some(Sensor { width_px, height_px, line_time_s: None, last_row_first: false }), ..Self::default() }
    }
}

impl StarState {
    /// Colours count from this B − V, that of a star like the Sun.
    pub const REFERENCE_COLOUR: f64 = 0.6;

    /// B − V minus [`Self::REFERENCE_COLOUR`]; zero where the colour is not known.
    #[must_use]
    pub fn colour_offset(&self) -> f64 {
        self.colour.map_or(0.0, |colour| colour - Self::REFERENCE_COLOUR)
    }
}

/// Constants of R = A·tan z + B·tan³ z, z the observed zenith distance.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RefractionConstants {
    /// A in radians.
    pub a_rad: f64,
    /// B in radians.
    pub b_rad: f64,
}

/// Star, exposure and image together.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Context {
    /// The star.
    pub star: StarState,
    /// The exposure.
    pub observation: Observation,
    /// The star's image in the exposure.
    pub image: StarImage,
}

impl Context {
    /// Star and exposure together; of the image nothing is known.
    #[must_use]
    pub fn new(star: StarState, observation: Observation) -> Self {
        Self { star, observation, image: StarImage::default() }
    }

    /// The same with what is known of the image.
    #[must_use]
    pub fn with_image(self, image: StarImage) -> Self {
        Self { image, ..self }
    }
}

/// A value from outside (SOFA, astropy, a paper) that an effect must reproduce.
#[derive(Clone, Debug)]
pub struct ReferenceValue {
    /// Which tool and version, or which publication, and how the value was made.
    pub source: &'static str,
    /// The case.
    pub context: Context,
    /// The effect's parameters.
    pub parameters: Vec<f64>,
    /// The light that goes in.
    pub before: Light<f64>,
    /// The light that must come out.
    pub after: Light<f64>,
    /// The largest difference allowed: rad for a direction, px for a point.
    pub tolerance: f64,
}

impl ReferenceValue {
    /// A case of an effect on directions.
    #[must_use]
    pub fn of_direction(
        source: &'static str,
        context: Context,
        parameters: Vec<f64>,
        before: [f64; 3],
        after: [f64; 3],
        tolerance: f64,
    ) -> Self {
        Self { source, context, parameters, before: Light::from(before), after: Light::from(after), tolerance }
    }

    /// A case of an effect on the focal plane: points in px relative to the principal point, which lies at `centre_px` of the frame.
    #[must_use]
    pub fn of_point(
        source: &'static str,
        context: Context,
        parameters: Vec<f64>,
        focal_length_px: f64,
        centre_px: [f64; 2],
        before_and_after: [[f64; 2]; 2],
        tolerance: f64,
    ) -> Self {
        let [measured, ideal] = before_and_after;
        let pixel_px = [measured[0] + centre_px[0], measured[1] + centre_px[1]];
        let light = |point_px| Light { direction: [0.0, 0.0, 1.0], point_px, pixel_px, focal_length_px };
        Self { source, context, parameters, before: light(measured), after: light(ideal), tolerance }
    }
}

/// What the author of a displacement writes.
pub trait Displacement: Sync {
    /// Its id in files.
    const ID: &'static str;
    /// Where it acts.
    const SEGMENT: Segment;
    /// Its parameters.
    const PARAMETERS: &'static [ParameterSpec];
    /// What is known of it beside its equation.
    const FACTS: Facts = Facts::NONE;

    /// Whether it changes from one pixel to the next, so that the error of a measured point is felt in it: an adjustment then takes it at the
    /// predicted point.
    const WITHIN_PIXELS: bool = false;

    /// Whether it displaces a star by numbers of its own that the catalogue holds (motion, distance), the errors of which all images of the
    /// star share.
    const PER_STAR: bool = false;

    /// The body. `parameters` come in the order of [`Self::PARAMETERS`].
    fn displace<T: Real>(parameters: &[T], light: Light<T>, context: &Context) -> Light<T>;

    /// The inverse of a projection: a vector along the direction that falls on the point (relative to the principal point), or `None`
    /// where none does. What is no projection leaves this as it is.
    fn ray<T: Real>(_parameters: &[T], _light: Light<T>) -> Option<[T; 3]> {
        None
    }

    /// What this exposure lacks for the effect to be computed or fitted, or `None` if it lacks nothing.
    fn unmet_requirement(observation: &Observation) -> Option<&'static str>;

    /// The same of one image: what the exposure or the image lacks for the effect to move the image.
    #[must_use]
    fn unmet_in_context(context: &Context) -> Option<&'static str> {
        Self::unmet_requirement(&context.observation)
    }

    /// Parameters with which the effect does nothing at all in this context; `None` for a projection, which always does something.
    fn identity(context: &Context) -> Option<Vec<f64>>;

    /// Parameters of the effect at its known size, where the recording's own metadata tells it; `None` where they must be fitted.
    fn predicted(observation: &Observation) -> Option<Vec<f64>>;

    /// Sizes that nature has where the size is not known: one found outside is not this effect.
    #[must_use]
    fn plausible_range() -> Option<Natural> {
        None
    }

    /// Indices of the parameters that are fitted where the effect is asked for by its id alone; the others keep their values unless they
    /// are asked for by name. All, unless the effect says otherwise.
    #[must_use]
    fn default_free(_observation: &Observation) -> Vec<usize> {
        (0..Self::PARAMETERS.len()).collect()
    }

    /// A parameter that no derivative tells where to look for (the place of a seam, a length), where there is one: a diagnosis of an effect
    /// that is not in force yet tries its values.
    #[must_use]
    fn searched(_observation: &Observation) -> Option<Searched> {
        None
    }

    /// What a renderer changes to show a change of the parameter with this index, where the effect moves no light but the measured centre.
    #[must_use]
    fn rendering(_parameter: usize) -> Option<Rendering> {
        None
    }

    /// Cases from outside.
    fn reference_values() -> Vec<ReferenceValue>;

    /// The source file of the effect, whose module documentation is its page.
    fn source() -> &'static str;
}

/// A displacement as the registry holds it.
pub trait AnyDisplacement: Sync {
    /// See [`Displacement::ID`].
    fn id(&self) -> &'static str;
    /// See [`Displacement::SEGMENT`].
    fn segment(&self) -> Segment;
    /// See [`Displacement::FACTS`].
    fn facts(&self) -> &'static Facts;
    /// Whether a diagnosis may find it: it is no projection and no part of every camera.
    fn is_hypothesis(&self) -> bool {
        self.segment() != Segment::Projection && !self.facts().is_of_every_camera
    }
    /// See [`Displacement::WITHIN_PIXELS`].
    fn is_within_pixels(&self) -> bool;
    /// See [`Displacement::PER_STAR`].
    fn is_of_the_star(&self) -> bool;
    /// See [`Displacement::PARAMETERS`].
    fn parameters(&self) -> &'static [ParameterSpec];
    /// The body on plain numbers.
    fn displace(&self, parameters: &[f64], light: Light<f64>, context: &Context) -> Light<f64>;
    /// The body on dual numbers.
    fn displace_jet(&self, parameters: &[Jet], light: Light<Jet>, context: &Context) -> Light<Jet>;
    /// See [`Displacement::ray`].
    fn ray(&self, parameters: &[f64], light: Light<f64>) -> Option<[f64; 3]>;
    /// See [`Displacement::ray`], on dual numbers.
    fn ray_jet(&self, parameters: &[Jet], light: Light<Jet>) -> Option<[Jet; 3]>;
    /// See [`Displacement::unmet_requirement`].
    fn unmet_requirement(&self, observation: &Observation) -> Option<&'static str>;
    /// See [`Displacement::unmet_in_context`].
    fn unmet_in_context(&self, context: &Context) -> Option<&'static str>;
    /// See [`Displacement::identity`].
    fn identity(&self, context: &Context) -> Option<Vec<f64>>;
    /// See [`Displacement::predicted`].
    fn predicted(&self, observation: &Observation) -> Option<Vec<f64>>;
    /// See [`Displacement::plausible_range`].
    fn plausible_range(&self) -> Option<Natural>;
    /// See [`Displacement::default_free`].
    fn default_free(&self, observation: &Observation) -> Vec<usize>;
    /// See [`Displacement::searched`].
    fn searched(&self, observation: &Observation) -> Option<Searched>;
    /// See [`Displacement::rendering`].
    fn rendering(&self, parameter: usize) -> Option<Rendering>;
    /// See [`Displacement::reference_values`].
    fn reference_values(&self) -> Vec<ReferenceValue>;
    /// The effect's page of documentation, Markdown.
    fn page(&self) -> String;
}

impl<D: Displacement> AnyDisplacement for D {
    fn id(&self) -> &'static str {
        D::ID
    }
    fn segment(&self) -> Segment {
        D::SEGMENT
    }
    fn facts(&self) -> &'static Facts {
        const { &D::FACTS }
    }
    fn is_within_pixels(&self) -> bool {
        D::WITHIN_PIXELS
    }
    fn is_of_the_star(&self) -> bool {
        D::PER_STAR
    }
    fn parameters(&self) -> &'static [ParameterSpec] {
        D::PARAMETERS
    }
    fn displace(&self, parameters: &[f64], light: Light<f64>, context: &Context) -> Light<f64> {
        D::displace(parameters, light, context)
    }
    fn displace_jet(&self, parameters: &[Jet], light: Light<Jet>, context: &Context) -> Light<Jet> {
        D::displace(parameters, light, context)
    }
    fn ray(&self, parameters: &[f64], light: Light<f64>) -> Option<[f64; 3]> {
        D::ray(parameters, light)
    }
    fn ray_jet(&self, parameters: &[Jet], light: Light<Jet>) -> Option<[Jet; 3]> {
        D::ray(parameters, light)
    }
    fn unmet_requirement(&self, observation: &Observation) -> Option<&'static str> {
        D::unmet_requirement(observation)
    }
    fn unmet_in_context(&self, context: &Context) -> Option<&'static str> {
        D::unmet_in_context(context)
    }
    fn identity(&self, context: &Context) -> Option<Vec<f64>> {
        D::identity(context)
    }
    fn predicted(&self, observation: &Observation) -> Option<Vec<f64>> {
        D::predicted(observation)
    }
    fn plausible_range(&self) -> Option<Natural> {
        D::plausible_range()
    }
    fn default_free(&self, observation: &Observation) -> Vec<usize> {
        D::default_free(observation)
    }
    fn searched(&self, observation: &Observation) -> Option<Searched> {
        D::searched(observation)
    }
    fn rendering(&self, parameter: usize) -> Option<Rendering> {
        D::rendering(parameter)
    }
    fn reference_values(&self) -> Vec<ReferenceValue> {
        D::reference_values()
    }
    fn page(&self) -> String {
        super::page_of(D::source())
    }
}

/// Solves r(θ) = `target` for θ, both of any kind of number, where r grows with θ: what projections and radial distortions without a
/// closed inverse need. Newton's method on plain numbers from `start`, kept within [0, `largest`], then one step in `T`, which by the
/// implicit function theorem carries the exact derivatives. `None` where r does not reach the target or has a flat place on the way.
///
/// `function` gives r and its slope.
pub fn invert<T: Real>(target: T, start: f64, largest: f64, function: impl Fn(T) -> [T; 2]) -> Option<T> {
    const STEPS: usize = 60;
    let aim = target.value();
    let mut theta = start.clamp(0.0, largest);
    for _ in 0..STEPS {
        let [r, slope] = function(T::constant(theta)).map(Real::value);
        if slope.is_nan() || slope <= 0.0 {
            return None;
        }
        let next = (theta + (aim - r) / slope).clamp(0.0, largest);
        let step = (next - theta).abs();
        theta = next;
        if step <= 4.0 * f64::EPSILON * theta.max(1e-3) {
            break;
        }
    }
    let at = T::constant(theta);
    let [r, slope] = function(at);
    let reached = (r.value() - aim).abs() <= 1e-11 * aim.abs().max(1.0);
    (reached && slope.value() > 0.0).then(|| at + (target - r) / slope.value())
}
