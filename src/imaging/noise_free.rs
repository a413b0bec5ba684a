//! Noise-free propagation of single sources through the effects, for the truth of a star beside its position.
//!
//! It is worked out by the twins on the CPU whatever the backend, so the truth of a frame does not depend on where it was rendered.

use super::on_cpu::{self, Pixels};
use super::plan::{Lit, Plan};
use super::{FrameExposure, Imager, ImagingError, PlaneLight, Stamp};
use crate::effects::ids;
use crate::effects::pixel::{ExposureContext, Role, Stage};

/// The chain of an exposure without noise.
#[derive(Debug)]
pub struct NoiseFree<'a> {
    /// Without chance and without what cuts.
    pub(super) plan: Plan,
    exposure: FrameExposure<'a>,
    context: ExposureContext,
    light: Pixels<'a>,
    /// What follows the light, pixel by pixel, with the converter.
    counts: Pixels<'a>,
    full_well_e: Option<f64>,
    saturation_dn: Option<f32>,
    read_noise_e: f64,
}

/// What [`Stage::Light`] makes of a source in the pixels of its stamp, row by row.
#[derive(Clone, Debug, PartialEq)]
pub struct StampLight {
    /// Expected electrons of the source.
    pub electrons: Vec<f64>,
    /// Expected electrons that are there without any star.
    pub background_e: Vec<f64>,
}

impl Imager {
    /// The chain of an exposure without noise. Effects that depend on all the light of a frame take that of `exposure` and `planes`, now and
    /// in everything that is asked of the result.
    pub fn noise_free<'a>(&self, exposure: &FrameExposure<'a>, planes: &[PlaneLight<'a>]) -> Result<NoiseFree<'a>, ImagingError> {
        let context = self.plan.context(exposure, &self.plan.light(exposure, planes)?);
        let without_noise = self.plan.only(|effect| effect.role() != Role::Noise);
        let ready = |effects| Pixels::new(&self.plan, effects, exposure, &context);
        let of_light = without_noise.effects_up_to(Some(Stage::Light));
        let (light, counts) = (ready(of_light), ready(&without_noise.effects_up_to(Some(Stage::Digital))[of_light.len()..]));
        Ok(NoiseFree {
            plan: without_noise.only(|effect| effect.role() != Role::Cuts),
            exposure: *exposure,
            light,
            counts,
            context,
            full_well_e: self.plan.parameter(ids::BLOOMING, "full_well_e"),
            saturation_dn: self.plan.saturation_dn(),
            read_noise_e: self.plan.parameter(ids::READ_NOISE, "read_noise_e").unwrap_or(0.0),
        })
    }
}

impl NoiseFree<'_> {
    /// Whether any effect before the converter changes the light of a star or moves it.
    #[must_use]
    pub fn shapes_light(&self) -> bool {
        self.plan.effects_up_to(Some(Stage::Readout)).iter().any(|enabled| enabled.effect.role() == Role::Shapes)
    }

    /// Noise of reading a pixel.
    #[must_use]
    pub fn read_noise_e(&self) -> f64 {
        self.read_noise_e
    }

    /// A source in its pixels after [`Stage::Light`], and what else they hold there. Light adds up: a pixel's expected electrons are a share
    /// of the source's and a part that does not depend on it.
    #[must_use]
    pub fn seen(&self, stamp: &Stamp) -> StampLight {
        /// Electrons by which a pixel's share is found; a power of two, so that a share of 1 comes out as 1.
        const PROBE_E: f32 = 1_048_576.0;
        let mut dark = self.sky_e(stamp);
        let mut lit: Vec<f32> = dark.iter().map(|electrons| electrons + PROBE_E).collect();
        self.apply(&self.light, stamp, &mut dark);
        self.apply(&self.light, stamp, &mut lit);
        let shares = lit.iter().zip(&dark).map(|(lit, dark)| f64::from(lit - dark) / f64::from(PROBE_E));
        StampLight {
            electrons: shares.zip(&stamp.electrons).map(|(share, electrons)| share * f64::from(*electrons)).collect(),
            background_e: dark.into_iter().map(f64::from).collect(),
        }
    }

    /// Whether a pixel of the stamp is expected to be full: with its own gain and offset it reaches the top of the converter, or its charge
    /// overflows. What passes move between pixels is left out.
    #[must_use]
    pub fn is_full(&self, stamp: &Stamp, seen: &StampLight) -> bool {
        let mut held: Vec<f32> = seen.electrons.iter().zip(&seen.background_e).map(|(own, other)| (own + other) as f32).collect();
        if self.full_well_e.is_some_and(|full_well_e| held.iter().any(|electrons| f64::from(*electrons) >= full_well_e)) {
            return true;
        }
        let Some(saturation_dn) = self.saturation_dn else { return false };
        self.apply(&self.counts, stamp, &mut held);
        held.iter().any(|count| *count >= saturation_dn)
    }

    /// The whole frame with this light and no other, after all effects up to and with [`Stage::Readout`] but noise and what cuts, row by row.
    pub fn readout(&self, exposure: &FrameExposure<'_>, planes: &[PlaneLight<'_>]) -> Result<Vec<f32>, ImagingError> {
        self.frame(Some(Stage::Readout), exposure, planes)
    }

    /// The whole frame with the light of these stars alone, before any effect, row by row.
    pub fn light_alone(&self, exposure: &FrameExposure<'_>, planes: &[PlaneLight<'_>]) -> Result<Vec<f32>, ImagingError> {
        self.frame(None, &FrameExposure { sky_e: &[], ..*exposure }, planes)
    }

    fn frame(&self, stage: Option<Stage>, exposure: &FrameExposure<'_>, planes: &[PlaneLight<'_>]) -> Result<Vec<f32>, ImagingError> {
        let lit: Lit<'_> = self.plan.light(exposure, planes)?;
        Ok(on_cpu::electrons_in(&self.plan, stage, (&lit, &[]), &self.exposure, &self.context))
    }

    /// Electrons of the sky in the pixels of a stamp, before any effect.
    fn sky_e(&self, stamp: &Stamp) -> Vec<f32> {
        let mut electrons = vec![0.0; stamp.electrons.len()];
        for (row, own) in electrons.chunks_exact_mut(stamp.width_px.max(1)).enumerate() {
            let first = (stamp.top_px + row) * self.plan.width_px + stamp.left_px;
            if let Some(sky) = self.exposure.sky_e.get(first..first + own.len()) {
                own.copy_from_slice(sky);
            }
        }
        electrons
    }

    /// Sends the pixels of a stamp through effects.
    fn apply(&self, effects: &Pixels<'_>, stamp: &Stamp, pixels: &mut [f32]) {
        for (row, run) in pixels.chunks_exact_mut(stamp.width_px.max(1)).enumerate() {
            effects.apply((stamp.top_px + row) * self.plan.width_px + stamp.left_px, run);
        }
    }
}
