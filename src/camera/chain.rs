//! The chain of displacements from a catalogue star to the direction from which its light arrives, and the physics in use.

use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::Term;
use crate::catalog::{Catalog, Star};
use crate::coordinates::{Apparent, Direction, Icrs};
use crate::effects::sky::proper_motion::ProperMotion;
use crate::effects::{Context, DISPLACEMENTS, Displacement as _, Light, Observation, RefractionConstants, Segment, Sensor, StarState};
use crate::statistics::order::sort_by_key;

/// Which effects of known size a model contains: the argument of `--physics`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Physics {
    /// None: stars stay where the catalogue has them.
    None,
    /// All whose size follows from the recording's own metadata.
    Known,
    /// These; each must be computable for every frame.
    List(Vec<String>),
}

/// What is wrong with a choice of physics.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[non_exhaustive]
pub enum PhysicsError {
    /// No effect has this id.
    #[error("--physics {given}: there is no effect of known size of this name; {suggestion}")]
    Unknown {
        /// The word given.
        given: String,
        /// What to do.
        suggestion: String,
    },
    /// The effect was asked for by name, and cannot be computed.
    #[error(
        "--physics {id}: the effect cannot be computed, because {reason}; leave it out of the list or add what is missing to the recording"
    )]
    NotComputable {
        /// The effect.
        id: String,
        /// Why not.
        reason: String,
    },
}

impl std::str::FromStr for Physics {
    type Err = PhysicsError;

    fn from_str(text: &str) -> Result<Self, PhysicsError> {
        match text.trim() {
            "none" => Ok(Self::None),
            "known" => Ok(Self::Known),
            list => {
                let ids: Vec<String> = list.split(',').map(|id| id.trim().to_owned()).collect();
                for id in &ids {
                    if !known_effects().any(|known| known == id) {
                        return Err(PhysicsError::Unknown { given: id.clone(), suggestion: suggestion(id) });
                    }
                }
                Ok(Self::List(ids))
            }
        }
    }
}

/// The effects whose size can be known: in an exposure of which everything is known, it is.
fn known_effects() -> impl Iterator<Item = &'static str> {
    let everything = Observation {
        epoch_yr: Some(2000.0),
        position_au: Some([1.0, 0.0, 0.0]),
        sun_au: Some([1.0, 0.0, 0.0]),
        velocity_km_s: Some([0.0, 30.0, 0.0]),
        zenith: Some([0.0, 0.0, 1.0]),
        refraction: Some(RefractionConstants { a_rad: 2.8e-4, b_rad: -3e-7 }),
        earth_from_icrs: Some([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
        rate_rad_s: Some([1e-3; 3]),
        exposure_s: Some(1.0),
        sensor: Some(Sensor { width_px: 1024, height_px: 1024, line_time_s: Some(1e-5), last_row_first: false }),
        ..Observation::default()
    };
    DISPLACEMENTS.iter().filter(move |effect| effect.predicted(&everything).is_some()).map(|effect| effect.id())
}

impl Physics {
    /// The effects of known size behind the lens (those of the sky are in [`SkyChain`]) with their parameters, for exposures of one
    /// camera: those that can be computed for all of them.
    pub fn terms_behind_the_lens(&self, observations: &[Observation]) -> Result<Vec<Term>, PhysicsError> {
        let mut terms = Vec::new();
        for effect in DISPLACEMENTS.iter().filter(|effect| effect.segment() != Segment::Sky) {
            let wanted = match self {
                Self::None => false,
                Self::Known => true,
                Self::List(ids) => ids.iter().any(|id| id == effect.id()),
            };
            let known: Vec<_> = observations.iter().filter_map(|observation| effect.predicted(observation)).collect();
            let everywhere = !known.is_empty() && known.len() == observations.len() && known.iter().all(|one| *one == known[0]);
            if wanted && everywhere {
                terms.push(Term { effect: effect.id().to_owned(), parameters: known[0].clone() });
            } else if wanted && matches!(self, Self::List(_)) {
                let reason = observations.iter().find_map(|observation| effect.unmet_requirement(observation));
                let reason = reason.unwrap_or("its size must be fitted, or is not the same in all frames").to_owned();
                return Err(PhysicsError::NotComputable { id: effect.id().to_owned(), reason });
            }
        }
        Ok(terms)
    }
}

/// Says which words would have been understood, the most similar first.
fn suggestion(given: &str) -> String {
    let mut ids: Vec<&str> = known_effects().chain(["known", "none"]).collect();
    sort_by_key(&mut ids, |id| strsim::damerau_levenshtein(given, id));
    if strsim::damerau_levenshtein(given, ids[0]) <= 3 {
        format!("did you mean {}?", ids[0])
    } else {
        format!("choose known, none, or a list from: {}", known_effects().collect::<Vec<_>>().join(", "))
    }
}

/// The displacements in force during one exposure, with their parameters.
#[derive(Clone, Debug, Default)]
pub struct SkyChain {
    observation: Observation,
    links: Vec<(usize, Vec<f64>)>,
}

impl SkyChain {
    /// The chain for an exposure.
    pub fn new(physics: &Physics, observation: Observation) -> Result<Self, PhysicsError> {
        let mut links = Vec::new();
        for (index, effect) in DISPLACEMENTS.iter().enumerate().filter(|(_, effect)| effect.segment() == Segment::Sky) {
            let wanted = match physics {
                Physics::None => false,
                Physics::Known => true,
                Physics::List(ids) => ids.iter().any(|id| id == effect.id()),
            };
            if !wanted {
                continue;
            }
            match (effect.predicted(&observation), physics) {
                (Some(parameters), _) => links.push((index, parameters)),
                (None, Physics::List(_)) => {
                    let reason = effect.unmet_requirement(&observation).unwrap_or(effect.facts().unknown_size);
                    let reason = reason.to_owned();
                    return Err(PhysicsError::NotComputable { id: effect.id().to_owned(), reason });
                }
                (None, _) => {}
            }
        }
        Ok(Self { observation, links })
    }

    /// The chain of a simulated exposure: effects with the parameters that the scene gives them, in the order of the registry.
    #[must_use]
    pub fn with_parameters(observation: Observation, effects: &[(&str, Vec<f64>)]) -> Self {
        let links = DISPLACEMENTS
            .iter()
            .enumerate()
            .filter(|(_, effect)| effect.segment() == Segment::Sky)
            .filter_map(|(index, effect)| {
                effects.iter().find(|(id, _)| *id == effect.id()).map(|(_, parameters)| (index, parameters.clone()))
            })
            .collect();
        Self { observation, links }
    }

    /// Ids of the effects in force, in the order in which the light meets them.
    #[must_use]
    pub fn ids(&self) -> Vec<&'static str> {
        self.links.iter().map(|(index, _)| DISPLACEMENTS[*index].id()).collect()
    }

    /// The effects in force with their parameters.
    #[must_use]
    pub fn effects(&self) -> Vec<(&'static str, &[f64])> {
        self.links.iter().map(|(index, parameters)| (DISPLACEMENTS[*index].id(), parameters.as_slice())).collect()
    }

    /// What is known of the exposure.
    #[must_use]
    pub fn observation(&self) -> &Observation {
        &self.observation
    }

    /// The direction from which a catalogue star's light arrives.
    #[must_use]
    pub fn apparent(&self, star: &Star, epoch_yr: f64) -> Direction<Apparent> {
        self.apparent_in(&StarState::of(star, epoch_yr), &self.observation)
    }

    /// The directions of all stars of a catalogue, in its order.
    #[must_use]
    pub fn apparent_all(&self, catalog: &Catalog) -> Vec<Direction<Apparent>> {
        catalog.stars.iter().map(|star| self.apparent(star, catalog.epoch_yr)).collect()
    }

    /// The direction that a star without proper motion and parallax, seen in this apparent direction, has in the ICRS: what has
    /// been done to the light by the effects in force is taken out.
    #[must_use]
    pub fn icrs_from_apparent(&self, apparent: &Direction<Apparent>) -> Direction<Icrs> {
        // The displacements are small and smooth, so the fixed point is reached within a few steps: each shrinks the error
        // by the effect's own derivative (1e-4 for aberration, 1e-2 for refraction at 5° altitude).
        const STEPS: usize = 20;
        let mut guess = apparent.xyz;
        for _ in 0..STEPS {
            let star = StarState { direction: guess, ..self.still_star() };
            let reached = self.apparent_in(&star, &self.observation).xyz;
            let error = [0, 1, 2].map(|axis| apparent.xyz[axis] - reached[axis]);
            guess = Direction::<Icrs>::along([0, 1, 2].map(|axis| guess[axis] + error[axis])).xyz;
            if error.iter().all(|component| component.abs() < 1e-15) {
                break;
            }
        }
        Direction::along(guess)
    }

    /// A star without proper motion, parallax and colour of its own, whose place is that of the exposure's own epoch; it has yet to be given a direction.
    #[must_use]
    pub fn still_star(&self) -> StarState {
        StarState { epoch_yr: self.observation.epoch_yr.unwrap_or_default(), ..StarState::default() }
    }

    /// The place that a catalogue star has in the ICRS, seen from the barycentre of the solar system, and the date of that place, Julian year: that of
    /// the exposure where proper motion is in force, else the catalogue's. [`Self::icrs_from_apparent`] leads back to it, but for the star's parallax.
    #[must_use]
    pub fn place(&self, star: &Star, epoch_yr: f64) -> (Direction<Icrs>, f64) {
        let moved = self.links.iter().find(|(index, _)| DISPLACEMENTS[*index].id() == ProperMotion::ID);
        let Some(((index, parameters), own_yr)) = moved.zip(self.observation.epoch_yr) else { return (star.direction, epoch_yr) };
        let context = Context::new(StarState::of(star, epoch_yr), self.observation);
        let light = DISPLACEMENTS[*index].displace(parameters, Light::from(star.direction.xyz), &context);
        (Direction::from_unit(light.direction), own_yr + parameters.first().copied().unwrap_or_default())
    }

    /// The same at a moment of other circumstances.
    #[must_use]
    pub fn apparent_in(&self, star: &StarState, observation: &Observation) -> Direction<Apparent> {
        let context = Context::new(*star, *observation);
        let mut light = Light::from(star.direction);
        for (index, parameters) in &self.links {
            light = DISPLACEMENTS[*index].displace(parameters, light, &context);
        }
        Direction::from_unit(light.direction)
    }
}

impl StarState {
    /// What a catalogue says of a star.
    #[must_use]
    pub fn of(star: &Star, epoch_yr: f64) -> Self {
        Self {
            direction: star.direction.xyz,
            epoch_yr,
            proper_motion_rad_yr: star.proper_motion_rad_yr.unwrap_or_default(),
            parallax_rad: star.parallax_rad,
            magnitude: star.magnitude,
            colour: star.colour,
        }
    }
}
