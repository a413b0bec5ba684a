//! What a displacement is, and the registry of all of them.

use crate::dual::{Jet, Real};
use crate::effects::optics::{brown_conrady, pinhole};
use crate::effects::sky::{parallax, proper_motion, refraction, stellar_aberration};

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

/// Where along the way of the light a displacement acts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Segment {
    /// On the direction, in ICRS axes, before the camera's attitude. `displace` takes the direction before to the direction after.
    Sky,
    /// The joint of the two: from a direction in camera axes to a point on the ideal focal plane, px from the corner.
    Projection,
    /// On the focal plane, as a correction: `displace` takes the MEASURED point to the point before the effect. The renderer inverts it.
    Focal,
}

/// A star's light along the chain.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Light<T> {
    /// Unit vector: ICRS axes in [`Segment::Sky`], camera axes from [`Segment::Projection`] on.
    pub direction: [T; 3],
    /// Point on the focal plane in px relative to the principal point; used in [`Segment::Focal`].
    pub point_px: [T; 2],
}

/// What is known of the star whose light it is.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
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
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Observation {
    /// Middle of the exposure, Julian year (TDB).
    pub epoch_yr: Option<f64>,
    /// Barycentric position of the camera, au, ICRS axes.
    pub position_au: Option<[f64; 3]>,
    /// Barycentric velocity of the camera, km/s, ICRS axes.
    pub velocity_km_s: Option<[f64; 3]>,
    /// Unit vector to the zenith, ICRS axes.
    pub zenith: Option<[f64; 3]>,
    /// Refraction of the site's air.
    pub refraction: Option<RefractionConstants>,
}

/// Constants of R = A·tan z + B·tan³ z, z the observed zenith distance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RefractionConstants {
    /// A in radians.
    pub a_rad: f64,
    /// B in radians.
    pub b_rad: f64,
}

/// Star and exposure together.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Context {
    /// The star.
    pub star: StarState,
    /// The exposure.
    pub observation: Observation,
}

impl Context {
    /// Star and exposure together.
    #[must_use]
    pub fn new(star: StarState, observation: Observation) -> Self {
        Self { star, observation }
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
        let light = |direction| Light { direction, point_px: [0.0; 2] };
        Self { source, context, parameters, before: light(before), after: light(after), tolerance }
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

    /// The body. `parameters` come in the order of [`Self::PARAMETERS`].
    fn displace<T: Real>(parameters: &[T], light: Light<T>, context: &Context) -> Light<T>;

    /// Why the effect cannot be computed for this exposure, or `None` if it can.
    fn missing(observation: &Observation) -> Option<&'static str>;

    /// Parameters with which the effect does nothing at all in this context; `None` for a projection, which always does something.
    fn identity(context: &Context) -> Option<Vec<f64>>;

    /// Parameters of the effect at its known size, where the recording's own metadata tells it; `None` where they must be fitted.
    fn known(observation: &Observation) -> Option<Vec<f64>>;

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
    /// See [`Displacement::PARAMETERS`].
    fn parameters(&self) -> &'static [ParameterSpec];
    /// The body on plain numbers.
    fn displace(&self, parameters: &[f64], light: Light<f64>, context: &Context) -> Light<f64>;
    /// The body on dual numbers.
    fn displace_jet(&self, parameters: &[Jet], light: Light<Jet>, context: &Context) -> Light<Jet>;
    /// See [`Displacement::missing`].
    fn missing(&self, observation: &Observation) -> Option<&'static str>;
    /// See [`Displacement::identity`].
    fn identity(&self, context: &Context) -> Option<Vec<f64>>;
    /// See [`Displacement::known`].
    fn known(&self, observation: &Observation) -> Option<Vec<f64>>;
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
    fn parameters(&self) -> &'static [ParameterSpec] {
        D::PARAMETERS
    }
    fn displace(&self, parameters: &[f64], light: Light<f64>, context: &Context) -> Light<f64> {
        D::displace(parameters, light, context)
    }
    fn displace_jet(&self, parameters: &[Jet], light: Light<Jet>, context: &Context) -> Light<Jet> {
        D::displace(parameters, light, context)
    }
    fn missing(&self, observation: &Observation) -> Option<&'static str> {
        D::missing(observation)
    }
    fn identity(&self, context: &Context) -> Option<Vec<f64>> {
        D::identity(context)
    }
    fn known(&self, observation: &Observation) -> Option<Vec<f64>> {
        D::known(observation)
    }
    fn reference_values(&self) -> Vec<ReferenceValue> {
        D::reference_values()
    }
    fn page(&self) -> String {
        page_of(D::source())
    }
}

/// The module documentation (`//!` lines) of a source file, as Markdown.
#[must_use]
pub fn page_of(source: &str) -> String {
    let lines = source.lines().map_while(|line| line.strip_prefix("//!"));
    lines.map(|line| line.strip_prefix(' ').unwrap_or(line).to_owned() + "\n").collect()
}

/// Every displacement, in the order in which the light meets them.
pub static DISPLACEMENTS: &[&dyn AnyDisplacement] = &[
    &proper_motion::ProperMotion,
    &parallax::Parallax,
    &stellar_aberration::StellarAberration,
    &refraction::Refraction,
    &pinhole::Pinhole,
    &brown_conrady::BrownConrady,
];

/// The displacement with this id.
#[must_use]
pub fn displacement(id: &str) -> Option<&'static dyn AnyDisplacement> {
    DISPLACEMENTS.iter().copied().find(|effect| effect.id() == id)
}
