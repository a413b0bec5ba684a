//! # Proper motion
//!
//! ## What it does
//!
//! Stars move; a catalogue gives their directions at its own epoch.
//!
//! ## Equation
//!
//! Straight motion through space, seen from the barycentre:
//! u(t) = u₀ + (μ_α* ê + μ_δ n̂)·(t + offset − t₀), normalised; ê, n̂ = east and north at u₀.
//!
//! ## Parameters
//!
//! `epoch_offset_yr` (Julian years): the recording's epoch minus the one its time tags say; 0 for a true clock.
//!
//! ## Signature
//!
//! A displacement that differs from star to star and grows with the years since the catalogue's
//! epoch: for V ≤ 6 a median of 42 mas/yr, 1.5″ since J1991.25. It hides in the tails, not in the core, of the residuals.
//!
//! ## Confused with
//!
//! A wrong epoch (it is one); parallax in a single night.
//!
//! ## Neglected
//!
//! Radial velocity (perspective acceleration: below 1 mas in 50 years except for a handful of nearby stars), and the
//! light-travel time across the solar system (below 0.2 mas). Stars whose proper motion is not known stay where the catalogue has
//! them; their position error says so ([`crate::catalog::Catalog`]).
//!
//! ## Source
//!
//! The Hipparcos and Tycho Catalogues, ESA SP-1200 (1997), vol. 1, section 1.5.5, "standard model of stellar motion";
//! SOFA routines `pmpx` and `starpm`.

use crate::dual::{Real, add, constant, normalize, scale};
use crate::effects::{Context, Displacement, Facts, Light, Observation, OrdinarySize, ParameterSpec, ReferenceValue, Segment, StarState};
use crate::units::MAS_RAD;

/// Proper motion.
#[derive(Clone, Copy, Debug)]
pub struct ProperMotion;

/// Unit vectors to the east and to the north at a direction. At a pole east is +y.
#[must_use]
pub fn east_north(direction: [f64; 3]) -> ([f64; 3], [f64; 3]) {
    let [x, y, z] = direction;
    let r = x.hypot(y);
    let (cos_ra, sin_ra) = if r > 0.0 { (x / r, y / r) } else { (1.0, 0.0) };
    ([-sin_ra, cos_ra, 0.0], [-cos_ra * z, -sin_ra * z, r])
}

impl Displacement for ProperMotion {
    const ID: &'static str = "proper-motion";
    const FACTS: Facts = Facts {
        ordinary_size: Some(OrdinarySize::of(26.0, "places of J2000.0 used in 2026")),
        profile_covariates: &[("", "proper-motion")],
        counts_from_model: true,
        covariate: Some("proper-motion"),
        demo_sizes: &[("epoch_offset_yr", 200.0)],
        ..Facts::NONE
    };
    const SEGMENT: Segment = Segment::Sky;
    const PER_STAR: bool = true;
    const PARAMETERS: &'static [ParameterSpec] =
        &[ParameterSpec { name: "epoch_offset_yr", unit: "yr", typical: 0.0, range: (-1000.0, 1000.0) }];

    fn displace<T: Real>(parameters: &[T], light: Light<T>, context: &Context) -> Light<T> {
        let StarState { direction, epoch_yr, proper_motion_rad_yr: [east_rad_yr, north_rad_yr], .. } = context.star;
        let (east, north) = east_north(direction);
        let velocity = add(scale(east, east_rad_yr), scale(north, north_rad_yr));
        let years = parameters[0] + (context.observation.epoch_yr.unwrap_or(epoch_yr) - epoch_yr);
        Light { direction: normalize(add(light.direction, scale(constant(velocity), years))), ..light }
    }

    fn unmet_requirement(observation: &Observation) -> Option<&'static str> {
        observation.epoch_yr.is_none().then_some("the time of the frames is not known")
    }

    fn identity(context: &Context) -> Option<Vec<f64>> {
        Some(vec![context.star.epoch_yr - context.observation.epoch_yr.unwrap_or(context.star.epoch_yr)])
    }

    fn predicted(observation: &Observation) -> Option<Vec<f64>> {
        observation.epoch_yr.map(|_| vec![0.0])
    }

    fn reference_values() -> Vec<ReferenceValue> {
        // pyerfa 2.0.1.5: pmpx(ra, dec, pmr / cos(dec), pmd, px = 0.28718, rv = 0, 35.25 yr, origin); 61 Cygni A, Hipparcos.
        let before = [0.567_814_288_988_673_8, -0.534_618_245_845_408_3, 0.625_915_540_971_356];
        let star = StarState {
            direction: before,
            epoch_yr: 1991.25,
            proper_motion_rad_yr: [4156.93 * MAS_RAD, 3259.39 * MAS_RAD],
            ..StarState::default()
        };
        let observation = Observation { epoch_yr: Some(2026.5), ..Observation::default() };
        let after = [0.568_047_204_606_438, -0.533_861_804_730_610_5, 0.626_349_700_078_628];
        vec![ReferenceValue::of_direction("pyerfa 2.0.1.5, pmpx", Context::new(star, observation), vec![0.0], before, after, 1e-14)]
    }

    fn source() -> &'static str {
        page_source!("proper_motion.rs")
    }
}
