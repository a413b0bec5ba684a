//! Pixel binning, n × n into one: on the chip, as charge, or behind the converter, as counts.
//!
//! The stages before it see the detector's own (native) pixels, those after it the joined ones. On the chip that is after everything that happens to
//! charge on its way to the amplifier, and before what the amplifier and the converter do: nonlinearity, read noise, banding, converter. Counts are
//! joined behind the converter and before compression. Each side is an [`Imager`] of its own, and the joined pixels are handed over between them:
//! they are joined where the native ones lie (on the GPU by `shaders/join.wgsl`), and no others are read back.

use rayon::prelude::*;
use schemars::JsonSchema;
use serde::Serialize;

use super::{
    Backend, EffectSetting, FrameExposure, Image16, Imager, ImagingConfig, ImagingError, NoiseFree, PlaneLight, SplitLimits, Stage,
};
use crate::effects::ids;
use crate::effects::pixel::PIXEL_EFFECTS;

/// Where pixels are joined.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum BinningPlace {
    /// As charge, before the amplifier.
    OnChip,
    /// As counts, behind the converter.
    Digital,
}

/// How pixels are joined.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, JsonSchema)]
pub struct Binning {
    /// Pixels along each side of a joined one.
    pub factor: usize,
    /// Whether a joined pixel holds their mean instead of their sum.
    pub is_mean: bool,
    /// Where.
    pub place: BinningPlace,
}

impl Binning {
    /// Pixels that are joined into one.
    #[must_use]
    pub fn pixels(&self) -> f64 {
        (self.factor * self.factor) as f64
    }

    /// What becomes of the sum of their electrons or counts.
    #[must_use]
    pub fn share(&self) -> f64 {
        if self.is_mean { 1.0 / self.pixels() } else { 1.0 }
    }

    /// What a sum of counts is divided by.
    pub(super) fn divisor(&self) -> u32 {
        if self.is_mean { (self.factor * self.factor) as u32 } else { 1 }
    }

    /// Read noise of a joined pixel over that of a native one, in electrons of the light. The noise of the amplifier comes once where charge is joined
    /// (and is as much larger as the charge is weakened to the mean), and once for each pixel where counts are.
    #[must_use]
    pub fn read_noise_factor(&self) -> f64 {
        match self.place {
            BinningPlace::OnChip => 1.0 / self.share(),
            BinningPlace::Digital => self.factor as f64,
        }
    }

    /// Electrons of native pixels, of which none holds more than its full well, into those of joined ones.
    ///
    /// # Panics
    /// If the frame is no whole number of joined pixels.
    #[must_use]
    pub fn join(&self, native: &[f32], width_px: usize, full_well_e: f32) -> Vec<f32> {
        let share = self.share() as f32;
        self.rows(native, width_px, |value| value.min(full_well_e), |sum: f32| sum * share)
    }

    /// Counts of native pixels into those of joined ones; a mean is rounded.
    ///
    /// # Panics
    /// If the frame is no whole number of joined pixels.
    #[must_use]
    pub fn join_counts(&self, native: &[u16], width_px: usize) -> Vec<u16> {
        let divisor = self.divisor();
        let whole = |sum: u32| u16::try_from((sum + divisor / 2) / divisor).unwrap_or(u16::MAX);
        self.rows(native, width_px, u32::from, whole)
    }

    /// Light of joined pixels on the native ones, evenly.
    #[must_use]
    pub fn share_out(&self, joined: &[f32], width_px: usize) -> Vec<f32> {
        let share = 1.0 / self.pixels() as f32;
        let mut native = Vec::with_capacity(joined.len() * self.factor * self.factor);
        for row in joined.chunks(width_px) {
            let line: Vec<f32> = row.iter().flat_map(|light| std::iter::repeat_n(light * share, self.factor)).collect();
            for _ in 0..self.factor {
                native.extend_from_slice(&line);
            }
        }
        native
    }

    fn rows<T, S, O>(&self, native: &[T], width_px: usize, take: impl Fn(T) -> S + Sync, give: impl Fn(S) -> O + Sync) -> Vec<O>
    where
        T: Copy + Sync,
        S: Copy + Default + std::ops::AddAssign,
        O: Copy + Default + Send,
    {
        let (factor, width) = (self.factor, width_px / self.factor);
        assert!(width * factor == width_px && native.len().is_multiple_of(width_px * factor), "a frame of whole joined pixels");
        let mut joined = vec![O::default(); native.len() / (factor * factor)];
        joined.par_chunks_mut(width).zip(native.par_chunks(width_px * factor)).for_each(|(row, rows)| {
            let mut sums = vec![S::default(); width];
            for line in rows.chunks(width_px) {
                for (sum, pixels) in sums.iter_mut().zip(line.chunks(factor)) {
                    for pixel in pixels {
                        *sum += take(*pixel);
                    }
                }
            }
            for (pixel, sum) in row.iter_mut().zip(sums) {
                *pixel = give(sum);
            }
        });
        joined
    }

    /// The effects before and those after it.
    fn split(&self, effects: &[EffectSetting]) -> [Vec<EffectSetting>; 2] {
        let place = |id: &str| PIXEL_EFFECTS.iter().position(|effect| effect.id() == id);
        let is_before = |id: &str| match self.place {
            BinningPlace::OnChip => place(id) < place(ids::NONLINEARITY),
            BinningPlace::Digital => place(id) <= place(ids::ADC),
        };
        let (before, after) = effects.iter().cloned().partition(|effect: &EffectSetting| is_before(&effect.id));
        [before, after]
    }
}

/// How electrons or counts are joined.
#[derive(Clone, Copy, Debug)]
pub(super) struct Joining {
    pub(super) binning: Binning,
    /// The most electrons of a pixel that are joined.
    pub(super) full_well_e: f32,
}

/// Makes frames of a camera that joins pixels.
#[derive(Debug)]
pub struct BinnedImager {
    binning: Binning,
    /// Columns and rows of joined pixels.
    joined_px: (usize, usize),
    full_well_e: f32,
    /// Up to the joining.
    native: Imager,
    /// From there on; `None`: nothing follows.
    joined: Option<Imager>,
}

impl BinnedImager {
    /// Opens the backend for a configuration whose frame is that of the native pixels. Those that are joined on the chip hold together what each
    /// of them holds: the converter's full well stands for one of them.
    pub fn new(backend: Backend, config: &ImagingConfig, binning: Binning) -> Result<Self, ImagingError> {
        Self::with_limits(backend, config, binning, SplitLimits::default())
    }

    /// The same, with work split at other sizes.
    pub fn with_limits(backend: Backend, config: &ImagingConfig, binning: Binning, limits: SplitLimits) -> Result<Self, ImagingError> {
        let (width_px, height_px, factor) = (config.width_px, config.height_px, binning.factor);
        if factor == 0 || !width_px.is_multiple_of(factor) || !height_px.is_multiple_of(factor) {
            return Err(ImagingError::BadBinning { width_px, height_px, factor });
        }
        let [before, mut after] = binning.split(&config.effects);
        let mut full_well_e = f32::INFINITY;
        let converter = after.iter_mut().find(|effect| effect.id == ids::ADC);
        if let Some((_, well)) = converter.and_then(|adc| adc.parameters.iter_mut().find(|(name, _)| name == "full_well_e")) {
            full_well_e = *well as f32;
            *well = (*well * binning.pixels() * binning.share()).min(1e12);
        }
        let native = Imager::for_joining(backend, &ImagingConfig { effects: before, ..config.clone() }, limits, factor)?;
        let of_joined = |effects| ImagingConfig { width_px: width_px / factor, height_px: height_px / factor, effects, ..config.clone() };
        let joined = if after.is_empty() { None } else { Some(Imager::with_limits(backend, &of_joined(after), limits)?) };
        Ok(Self { binning, joined_px: (width_px / factor, height_px / factor), full_well_e, native, joined })
    }

    /// The joined pixels' expected electrons, without noise, row by row: all that their native ones get, also where the camera gives their mean.
    pub fn expected_electrons(&self, exposure: &FrameExposure<'_>, planes: &[PlaneLight<'_>]) -> Result<Vec<f32>, ImagingError> {
        let joining = Joining { binning: Binning { is_mean: false, ..self.binning }, full_well_e: f32::INFINITY };
        self.native.electrons(Some(Stage::Light), exposure, planes, Some(joining))
    }

    /// A frame as the camera gives it.
    pub fn expose_with(&self, exposure: &FrameExposure<'_>, planes: &[PlaneLight<'_>]) -> Result<Image16, ImagingError> {
        let joined_exposure = |sky_e| FrameExposure { stars: &[], sky_e, ..*exposure };
        let joining = Some(Joining { binning: self.binning, full_well_e: self.full_well_e });
        match self.binning.place {
            BinningPlace::OnChip => {
                let joined = self.native.electrons(Some(Stage::Digital), exposure, planes, joining)?;
                self.joined.as_ref().ok_or(ImagingError::NoConverter)?.expose(&joined_exposure(&joined))
            }
            BinningPlace::Digital => {
                let pixels_dn = self.native.counts(exposure, planes, joining)?;
                let (width_px, height_px) = self.joined_px;
                let Some(imager) = &self.joined else { return Ok(Image16 { width_px, height_px, pixels_dn }) };
                let counts: Vec<f32> = pixels_dn.iter().map(|count| f32::from(*count)).collect();
                let after = imager.electrons_after(Some(Stage::Digital), &joined_exposure(&counts))?;
                let pixels_dn = after.into_iter().map(|count| count.round() as u16).collect();
                Ok(Image16 { width_px, height_px, pixels_dn })
            }
        }
    }
}

/// The chain of an exposure without noise, with joined pixels at its end.
#[derive(Debug)]
pub struct BinnedNoiseFree<'a> {
    binning: Binning,
    native_width_px: usize,
    native: NoiseFree<'a>,
    joined: Option<NoiseFree<'a>>,
}

impl BinnedImager {
    /// The chain of an exposure without noise, see [`Imager::noise_free`].
    pub fn noise_free<'a>(&self, exposure: &FrameExposure<'a>, planes: &[PlaneLight<'a>]) -> Result<BinnedNoiseFree<'a>, ImagingError> {
        let native = self.native.noise_free(exposure, planes)?;
        let dark = FrameExposure { stars: &[], sky_e: &[], ..*exposure };
        let joined = self.joined.as_ref().map(|joined| joined.noise_free(&dark, &[])).transpose()?;
        Ok(BinnedNoiseFree { binning: self.binning, native_width_px: self.joined_px.0 * self.binning.factor, native, joined })
    }
}

impl BinnedNoiseFree<'_> {
    /// See [`NoiseFree::shapes_light`].
    #[must_use]
    pub fn shapes_light(&self) -> bool {
        self.native.shapes_light() || self.joined.as_ref().is_some_and(NoiseFree::shapes_light)
    }

    /// See [`NoiseFree::readout`]: joined pixels, in electrons of the light also where they hold the mean of their native ones.
    pub fn readout(&self, exposure: &FrameExposure<'_>, planes: &[PlaneLight<'_>]) -> Result<Vec<f32>, ImagingError> {
        let native = self.native.readout(exposure, planes)?;
        let held = self.binning.join(&native, self.native_width_px, f32::INFINITY);
        let mut read = match &self.joined {
            Some(joined) => joined.readout(&FrameExposure { stars: &[], sky_e: &held, ..*exposure }, &[])?,
            None => held,
        };
        let share = self.binning.share() as f32;
        for electrons in &mut read {
            *electrons /= share;
        }
        Ok(read)
    }

    /// See [`NoiseFree::light_alone`]: all that falls on each joined pixel.
    pub fn light_alone(&self, exposure: &FrameExposure<'_>, planes: &[PlaneLight<'_>]) -> Result<Vec<f32>, ImagingError> {
        let sum = Binning { is_mean: false, ..self.binning };
        Ok(sum.join(&self.native.light_alone(exposure, planes)?, self.native_width_px, f32::INFINITY))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sums_and_means_of_squares() {
        let sum = Binning { factor: 2, is_mean: false, place: BinningPlace::OnChip };
        let native = [1.0, 2.0, 10.0, 20.0, 3.0, 4.0, 30.0, 900.0];
        assert_eq!(sum.join(&native, 4, f32::INFINITY), [10.0, 960.0]);
        assert_eq!(sum.join(&native, 4, 100.0), [10.0, 160.0]);
        let mean = Binning { is_mean: true, ..sum };
        assert_eq!(mean.join(&native, 4, f32::INFINITY), [2.5, 240.0]);
        let counts = [1, 2, 65_535, 65_535, 3, 4, 65_535, 65_535];
        assert_eq!(sum.join_counts(&counts, 4), [10, 65_535]);
        assert_eq!(mean.join_counts(&counts, 4), [3, 65_535]); // 2.5 is rounded up
        let three = Binning { factor: 3, ..mean };
        assert_eq!(sum.share_out(&[4.0, 8.0], 2), [1.0, 1.0, 2.0, 2.0, 1.0, 1.0, 2.0, 2.0]);
        assert_eq!(sum.join(&sum.share_out(&[4.0, 8.0], 2), 4, f32::INFINITY), [4.0, 8.0]);
        assert_eq!(three.join_counts(&[4, 4, 4, 4, 5, 4, 4, 4, 4], 3), [4]);
    }

    #[test]
    fn charge_is_joined_before_the_amplifier_and_counts_behind_the_converter() {
        let ids = |place| {
            let effects: Vec<_> = PIXEL_EFFECTS.iter().map(|effect| EffectSetting::new(effect.id(), &[])).collect();
            let [before, after] = Binning { factor: 2, is_mean: false, place }.split(&effects);
            assert_eq!(before.len() + after.len(), PIXEL_EFFECTS.len());
            [before.last().unwrap().id.clone(), after[0].id.clone()]
        };
        assert_eq!(ids(BinningPlace::OnChip), ["charge-transfer-inefficiency", "nonlinearity"]);
        assert_eq!(ids(BinningPlace::Digital), ["adc", "jpeg"]);
    }
}
