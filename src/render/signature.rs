//! Signatures: how far an effect moves, weakens and widens the measured images of stars, found by rendering them.
//!
//! Stars of a design (places, phases within the pixel, brightnesses, colours) are rendered without noise by two cameras that differ in one
//! parameter, and measured by whatever estimator the caller hands in. The difference over the step of the parameter is the column of that
//! parameter in the design matrix of a diagnosis, with the bias of the estimator in it. So an effect that can be rendered needs no formula.

use super::light::{FrameLight, Spreader, StarLight};
use super::psf_tables::PsfTables;
use crate::coordinates::PixelPoint;
use crate::frame::Frame;
use crate::imaging::{Backend, FrameExposure, Imager, ImagingConfig, ImagingError};
use crate::scene::{Sample, Scene, StarTrack};

/// A star of a design.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TestStar {
    /// Column of its place.
    pub x_px: f64,
    /// Row of its place.
    pub y_px: f64,
    /// Electrons that it sends.
    pub electrons: f64,
    /// B − V, where known.
    pub colour: Option<f64>,
}

/// What an estimator finds of a star, or the change of that per unit of a parameter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeasuredStar {
    /// Column, px.
    pub x_px: f64,
    /// Row, px.
    pub y_px: f64,
    /// Flux, electrons.
    pub flux_e: f64,
    /// Variance of the image along one axis, px².
    pub variance_px2: f64,
}

/// A scene's camera, ready to show the stars of a design.
#[derive(Debug)]
pub struct StampRenderer<'a> {
    scene: &'a Scene,
    imager: Imager,
    spreader: Spreader,
}

impl<'a> StampRenderer<'a> {
    /// The camera of a scene: its point spread and its pixel effects. Pixels that the scene joins are shown as single ones.
    pub fn new(scene: &'a Scene) -> Result<Self, ImagingError> {
        Self::with_tables(scene, &PsfTables::default())
    }

    /// The same with tables of point spreads that may be known already.
    pub(crate) fn with_tables(scene: &'a Scene, tables: &PsfTables) -> Result<Self, ImagingError> {
        let config = ImagingConfig {
            width_px: scene.camera.width_px,
            height_px: scene.camera.height_px,
            seed: scene.seed,
            point_spread: "gaussian_psf".to_owned(),
            effects: scene.pixel_effects.clone(),
        };
        Ok(Self { scene, imager: Imager::new(Backend::Cpu, &config)?, spreader: Spreader::new(&scene.psf, tables) })
    }

    /// A frame of these stars at rest, in electrons: after all effects up to the converter, without noise and without what cuts.
    ///
    /// # Panics
    /// If the scene has no exposure.
    pub fn frame(&self, stars: &[TestStar]) -> Result<Frame, ImagingError> {
        let lights: Vec<StarLight> = stars.iter().map(|star| self.spreader.light(&track(star))).collect();
        let light: FrameLight = lights.iter().collect();
        let first = self.scene.exposures.get(0);
        let exposure = FrameExposure {
            stars: &light.stars,
            sky_e: &[],
            exposure_s: first.exposure_s,
            frame_index: 0,
            temperature_c: first.telemetry.temperature_c,
        };
        let planes = self.spreader.planes(&light);
        let pixels_dn = self.imager.noise_free(&exposure, &planes)?.readout(&exposure, &planes)?;
        let (width_px, height_px) = (self.scene.camera.width_px, self.scene.camera.height_px);
        Ok(Frame { width_px, height_px, pixels_dn, saturation_dn: f32::MAX })
    }
}

/// A star that stands still at its place.
fn track(star: &TestStar) -> StarTrack {
    let place = PixelPoint { x_px: star.x_px, y_px: star.y_px };
    StarTrack {
        hip: 0,
        magnitude: 0.0,
        colour: star.colour,
        temperature_offset_k: 0.0,
        electrons: star.electrons,
        ideal: None,
        start_mid_end: [Some(place); 3],
        samples: vec![Sample { time_s: 0.0, weight: 1.0, place, shear: [0.0; 2] }],
        blur_px2: [0.0; 3],
    }
}

/// The change of what `measure` finds of each star of the design (a list of frames), per unit of the parameter in which `stronger`
/// exceeds `weaker` by `step`; frame by frame, star by star. `None` where the estimator fails.
pub fn signature(
    weaker: &StampRenderer<'_>,
    stronger: &StampRenderer<'_>,
    step: f64,
    design: &[Vec<TestStar>],
    measure: impl Fn(&Frame, &[TestStar]) -> Vec<Option<MeasuredStar>>,
) -> Result<Vec<Option<MeasuredStar>>, ImagingError> {
    let mut columns = Vec::new();
    for stars in design {
        let [less, more] = [weaker, stronger].map(|bench| bench.frame(stars).map(|frame| measure(&frame, stars)));
        let change = |(less, more): (Option<MeasuredStar>, Option<MeasuredStar>)| {
            let (less, more) = (less?, more?);
            Some(MeasuredStar {
                x_px: (more.x_px - less.x_px) / step,
                y_px: (more.y_px - less.y_px) / step,
                flux_e: (more.flux_e - less.flux_e) / step,
                variance_px2: (more.variance_px2 - less.variance_px2) / step,
            })
        };
        columns.extend(less?.into_iter().zip(more?).map(change));
    }
    Ok(columns)
}
