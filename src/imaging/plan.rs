//! Plan of a rendering: a checked configuration, with the effects that act, their order and their parameters.

use super::plane::{PlaneBatch, PlaneLight};
use super::tiles;
use super::{FrameExposure, ImagingConfig, ImagingError};
use crate::effects::detector::adc::full_pixel_dn;
use crate::effects::id_of;
use crate::effects::ids;
use crate::effects::pixel::{
    AnyPixelEffect, ExposureContext, PIXEL_EFFECTS, POINT_SPREADS, SeparablePsf, SeparableStar, Stage, Work, pixel_effect, separable_psf,
};
use crate::rng::StageKey;
use crate::statistics::order::sort_by_key;

/// A pixel effect that is switched on.
#[derive(Clone, Debug, PartialEq)]
pub struct EffectSetting {
    /// Its id.
    pub id: String,
    /// Its parameters by name, every one of them, in any order.
    pub parameters: Vec<(String, f64)>,
}

impl EffectSetting {
    /// An effect with its parameters by name.
    #[must_use]
    pub fn new(id: &str, parameters: &[(&str, f64)]) -> Self {
        Self { id: id_of(id), parameters: parameters.iter().map(|(name, value)| ((*name).to_owned(), *value)).collect() }
    }
}

/// An effect with its parameters in order.
#[derive(Clone)]
pub(super) struct Enabled {
    pub(super) effect: &'static dyn AnyPixelEffect,
    parameters: Vec<f64>,
}

impl std::fmt::Debug for Enabled {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}{:?}", self.effect.id(), self.parameters)
    }
}

impl Enabled {
    fn new(setting: &EffectSetting) -> Result<Self, ImagingError> {
        let known = || PIXEL_EFFECTS.iter().map(|effect| effect.id()).collect::<Vec<_>>().join(", ");
        let effect = pixel_effect(&setting.id).ok_or_else(|| ImagingError::UnknownEffect {
            kind: "pixel effect",
            id: setting.id.clone(),
            known: known(),
        })?;
        let (id, specs) = (effect.id(), effect.parameters());
        let bad_name = |problem, parameter: &str| ImagingError::BadParameterName {
            id,
            problem,
            parameter: parameter.to_owned(),
            known: specs.iter().map(|spec| spec.name).collect::<Vec<_>>().join(", "),
        };
        if let Some((stranger, _)) = setting.parameters.iter().find(|(name, _)| specs.iter().all(|spec| spec.name != name)) {
            return Err(bad_name("does not have", stranger));
        }
        let mut parameters = Vec::with_capacity(specs.len());
        for spec in specs {
            let (_, value) = setting.parameters.iter().find(|(name, _)| name == spec.name).ok_or_else(|| bad_name("needs", spec.name))?;
            let (low, high) = spec.range;
            if !(low..=high).contains(value) {
                return Err(ImagingError::OutOfRange { id, parameter: spec.name, value: *value, low, high });
            }
            parameters.push(*value);
        }
        Ok(Self { effect, parameters })
    }

    fn least_e(&self, context: &ExposureContext, least_e: f64) -> f64 {
        self.effect.least_e(&self.parameters, context, least_e)
    }

    pub(super) fn uniforms(&self, context: &ExposureContext) -> Vec<u8> {
        self.effect.uniforms(&self.parameters, context)
    }

    fn is_pass(&self) -> bool {
        matches!(self.effect.work(), Work::Frame(..))
    }
}

/// Effects that each see one pixel, run as one program; before them, if it is not the first of the frame, the pass that they follow.
#[derive(Clone, Copy, Debug)]
pub(super) struct Segment<'a> {
    pub(super) pass: Option<&'a Enabled>,
    pub(super) pixels: &'a [Enabled],
}

/// The light of an exposure, ready for the pixels.
#[derive(Debug)]
pub(super) struct Lit<'a> {
    /// Electrons of the sky, row by row; empty: none.
    pub(super) sky_e: &'a [f32],
    pub(super) stars: Vec<SeparableStar>,
    pub(super) planes: Vec<PlaneBatch<'a>>,
}

/// The checked configuration.
#[derive(Clone)]
pub(super) struct Plan {
    pub(super) width_px: usize,
    pub(super) height_px: usize,
    seed: u64,
    pub(super) spread: &'static dyn SeparablePsf,
    /// In the order in which they act.
    effects: Vec<Enabled>,
}

impl std::fmt::Debug for Plan {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} × {} px, seed {}, {}, {:?}", self.width_px, self.height_px, self.seed, self.spread.id(), self.effects)
    }
}

impl Plan {
    pub(super) fn new(config: &ImagingConfig) -> Result<Self, ImagingError> {
        let &ImagingConfig { width_px, height_px, seed, .. } = config;
        if !(1..=65_535).contains(&width_px) || !(1..=65_535).contains(&height_px) {
            return Err(ImagingError::BadSize { width_px, height_px });
        }
        let spread = separable_psf(&config.point_spread).ok_or_else(|| ImagingError::UnknownEffect {
            kind: "point spread",
            id: config.point_spread.clone(),
            known: POINT_SPREADS.iter().map(|spread| spread.id()).collect::<Vec<_>>().join(", "),
        })?;
        let mut effects = config.effects.iter().map(Enabled::new).collect::<Result<Vec<_>, _>>()?;
        sort_by_key(&mut effects, |enabled| PIXEL_EFFECTS.iter().position(|effect| effect.id() == enabled.effect.id()));
        if let Some(pair) = effects.windows(2).find(|pair| pair[0].effect.id() == pair[1].effect.id()) {
            return Err(ImagingError::EffectTwice { id: pair[0].effect.id() });
        }
        Ok(Self { width_px, height_px, seed, spread, effects })
    }

    /// The same with only some of the effects.
    pub(super) fn only(&self, keeps: impl Fn(&dyn AnyPixelEffect) -> bool) -> Self {
        Self { effects: self.effects.iter().filter(|enabled| keeps(enabled.effect)).cloned().collect(), ..self.clone() }
    }

    /// A parameter of an effect that is switched on.
    pub(super) fn parameter(&self, id: &str, name: &str) -> Option<f64> {
        let enabled = self.effects.iter().find(|enabled| enabled.effect.id() == id)?;
        let place = enabled.effect.parameters().iter().position(|spec| spec.name == name)?;
        enabled.parameters.get(place).copied()
    }

    /// The effects up to and with a stage.
    pub(super) fn effects_up_to(&self, stage: Option<Stage>) -> &[Enabled] {
        let count = self.effects.iter().take_while(|enabled| Some(enabled.effect.stage()) <= stage).count();
        &self.effects[..count]
    }

    /// The same, cut before every pass. There is at least one segment, and the first has no pass.
    pub(super) fn segments(&self, stage: Option<Stage>) -> Vec<Segment<'_>> {
        let mut left = self.effects_up_to(stage);
        let mut segments = Vec::new();
        let mut pass = None;
        loop {
            let (pixels, rest) = left.split_at(left.iter().position(Enabled::is_pass).unwrap_or(left.len()));
            segments.push(Segment { pass, pixels });
            let Some((next, after)) = rest.split_first() else { return segments };
            (pass, left) = (Some(next), after);
        }
    }

    /// Whether a pixel may hold less than that below which an effect goes a way of its own.
    pub(super) fn may_be_faint(&self, context: &ExposureContext, lit: &Lit<'_>) -> bool {
        /// Above all rounding.
        const MARGIN: f64 = 1.001;
        let mut least_e = lit.sky_e.iter().copied().reduce(f32::min).map_or(0.0, f64::from);
        self.effects.iter().any(|enabled| {
            let is_faint = enabled.effect.faint_below_e().is_some_and(|below_e| least_e < MARGIN * below_e);
            least_e = enabled.least_e(context, least_e);
            is_faint
        })
    }

    /// Whether an effect is switched on.
    pub(super) fn has(&self, id: &str) -> bool {
        self.effects.iter().any(|enabled| enabled.effect.id() == id)
    }

    pub(super) fn has_converter(&self) -> bool {
        self.has(ids::ADC)
    }

    /// What effects may know of an exposure.
    pub(super) fn context(&self, exposure: &FrameExposure<'_>, lit: &Lit<'_>) -> ExposureContext {
        let of_planes = lit.planes.iter().flat_map(|batch| batch.stars.iter().map(|star| star.electrons));
        ExposureContext {
            exposure_s: exposure.exposure_s,
            frame_index: exposure.frame_index,
            seed: self.seed,
            width_px: self.width_px,
            height_px: self.height_px,
            temperature_c: exposure.temperature_c,
            star_light_e: lit
                .stars
                .iter()
                .map(|star| star.electrons)
                .chain(of_planes)
                .chain(lit.sky_e.iter().copied())
                .map(f64::from)
                .sum(),
        }
    }

    pub(super) fn saturation_dn(&self) -> Option<f32> {
        self.effects.iter().find(|enabled| enabled.effect.id() == ids::ADC).map(|enabled| full_pixel_dn(&enabled.parameters))
    }

    /// The words of the seed, low first.
    pub(super) fn seed_words(&self) -> [u32; 2] {
        [self.seed as u32, (self.seed >> 32) as u32]
    }

    pub(super) fn key(&self, effect: &dyn AnyPixelEffect, exposure: &FrameExposure<'_>) -> StageKey {
        StageKey { seed: self.seed, frame: exposure.frame_index, stage: effect.rng_stage() }
    }

    /// The light of an exposure as it goes to the pixels.
    pub(super) fn light<'a>(&self, exposure: &FrameExposure<'a>, planes: &[PlaneLight<'a>]) -> Result<Lit<'a>, ImagingError> {
        let exposure_s = exposure.exposure_s;
        if !exposure_s.is_finite() || exposure_s < 0.0 {
            return Err(ImagingError::BadExposure { exposure_s });
        }
        let (sky_e, expected) = (exposure.sky_e, self.width_px * self.height_px);
        if !sky_e.is_empty() && (sky_e.len() != expected || !sky_e.iter().all(|electrons| electrons.is_finite())) {
            return Err(ImagingError::BadSky { given: sky_e.len(), expected });
        }
        let stars = tiles::prepare(exposure.stars, self.spread, self.width_px, self.height_px)?;
        let planes = planes.iter().map(|light| PlaneBatch::new(light, self.width_px, self.height_px)).collect::<Result<_, _>>()?;
        Ok(Lit { sky_e, stars, planes })
    }
}
