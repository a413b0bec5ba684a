//! Scene → Frame: projects the catalogue (f64, here), then lets the pixel effects make an image of it (f32, on the GPU or the CPU).

mod alone;
mod footprint;
mod light;
mod mask;
mod mosaic;
mod pixel_shift;
mod psf_tables;
mod result;
mod signature;
mod truth;

pub use crate::imaging::{Backend, GpuError, Image16, ImagingError};
inner!(alone::{StarAlone, StarsAlone});
inner!(footprint::Footprint);
inner!(psf_tables::PsfTables);
pub use mask::MaskFlag;
pub use truth::{TrueLight, TrueStar};
inner!(result::{
    SIGNATURE_FORMAT, SIMULATE_FORMAT, SignatureResult, SignatureStar, SignatureSummary, SimulateResult, SimulatedTruth, TRUTH_FORMAT,
    TruthEffect, TrueFrame,
});
inner!(signature::{MeasuredStar, StampRenderer, TestStar, signature});

use std::collections::HashMap;

use crate::catalog::Catalog;
use crate::effects::optics::tables::PixelResponse;
use crate::imaging::{BinnedImager, FrameExposure, Imager, ImagingConfig, PlaneLight, Stage};
use crate::parallel;
use crate::scene::{OtherLight, Psf, Scene, StarTrack};
use light::{FrameLight, Spreader, StarLight};
use mask::{joined_mask, mask};
use mosaic::{OnPixels, on_pixels};
use pixel_shift::{Chain, Light, PixelShift, pixel_shifts};
use truth::{Landed, Seen, true_stars};

/// A rendered exposure.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Rendered {
    /// Counts, row by row, the first row on top.
    pub pixels_dn: Vec<u16>,
    /// The stars that reach the frame, brightest first.
    pub stars: Vec<TrueStar>,
    /// What else shines or leaves charge.
    pub lights: Vec<TrueLight>,
    /// Expected electrons without noise, row by row: stars, sky and dark current after [`Stage::Light`]; where they were asked for.
    pub clean_e: Option<Vec<f32>>,
    /// Flags of the pixels, row by row, see [`MaskFlag`]; where they were asked for.
    pub mask: Option<Vec<u16>>,
    /// What the frame shows of each star, then of each of the other lights; where it was asked for.
    pub footprints: Option<Vec<Footprint>>,
}

/// Renders the frames of a scene, in any order: each depends on the scene and its own number alone.
#[derive(Debug)]
pub struct Renderer<'a> {
    scene: &'a Scene,
    catalog: &'a Catalog,
    /// Of the detector's own pixels.
    imager: Imager,
    /// Where they are joined.
    binned: Option<BinnedImager>,
    spreader: Spreader,
    /// For pixels that answer evenly, where the scene's do not.
    even_spreader: Option<Spreader>,
    asked: Asked,
}

/// What a renderer gives besides frame and places.
#[derive(Clone, Copy, Debug)]
#[allow(clippy::struct_excessive_bools, reason = "each is asked for by itself")]
struct Asked {
    pixel_shifts: bool,
    clean: bool,
    mask: bool,
    footprints: bool,
}

impl<'a> Renderer<'a> {
    /// Opens the backend for a scene.
    pub fn new(scene: &'a Scene, catalog: &'a Catalog, backend: Backend) -> Result<Self, ImagingError> {
        Self::with_tables(scene, catalog, backend, &PsfTables::default())
    }

    /// The same with tables of point spreads that earlier scenes made; what is missing is added.
    pub(crate) fn with_tables(scene: &'a Scene, catalog: &'a Catalog, backend: Backend, tables: &PsfTables) -> Result<Self, ImagingError> {
        // What a real frame adds is put in on the CPU alone.
        let backend = if scene.dark_frame.is_some() && backend == Backend::Auto { Backend::Cpu } else { backend };
        let config = ImagingConfig {
            width_px: scene.own_psf.own_per_px * scene.camera.width_px,
            height_px: scene.own_psf.own_per_px * scene.camera.height_px,
            seed: scene.seed,
            point_spread: "gaussian_psf".to_owned(),
            effects: scene.pixel_effects.clone(),
        };
        let imager = Imager::new(backend, &config)?;
        let binned = scene.binning.map(|binning| BinnedImager::new(backend, &config, binning)).transpose()?;
        let pixel = scene.own_psf.pixel;
        let is_even = pixel.cosine == [0.0; 2] && pixel.slope == [0.0; 2];
        let even = |mut psf: Psf| {
            psf.pixel = PixelResponse { cosine: [0.0; 2], slope: [0.0; 2], ..pixel };
            psf
        };
        let asked = Asked { pixel_shifts: true, clean: false, mask: false, footprints: false };
        let even_spreader = (!is_even).then(|| Spreader::new(&even(scene.own_psf.clone()), tables));
        let spreader = Spreader::new(&scene.own_psf, tables);
        Ok(Self { scene, catalog, imager, binned, spreader, even_spreader, asked })
    }

    /// Whether the truth tells what pixel effects add to each star's place and flux. Where any is on that changes the stars' light, this costs
    /// three more frames without noise on the CPU for each frame; else nothing.
    #[must_use]
    pub fn with_pixel_shifts(mut self, tells: bool) -> Self {
        self.asked.pixel_shifts = tells;
        self
    }

    /// Whether rendered frames come with their expected electrons.
    #[must_use]
    pub fn with_clean(mut self, gives: bool) -> Self {
        self.asked.clean = gives;
        self
    }

    /// Whether rendered frames come with masks.
    #[must_use]
    pub fn with_masks(mut self, gives: bool) -> Self {
        self.asked.mask = gives;
        self
    }

    /// Whether rendered frames come with what they show of each light.
    #[must_use]
    pub fn with_footprints(mut self, gives: bool) -> Self {
        self.asked.footprints = gives;
        self
    }

    /// On what frames are rendered: the adapter and its driver, or `cpu`.
    #[must_use]
    pub fn adapter(&self) -> String {
        self.imager.adapter()
    }

    /// Renders exposure number `index` of the scene.
    ///
    /// # Panics
    /// If `index` is not below the number of exposures.
    ///
    /// ```
    /// use boresight::catalog::Catalog;
    /// use boresight::render::{Backend, Renderer};
    /// use boresight::scene::Scene;
    ///
    /// let scene = Scene::parse(
    ///     "pleiades.toml",
    ///     "format = \"boresight-scene/1\"\ncamera = { width_px = 64, height_px = 64, focal_length_px = 900.0 }\n\
    ///      [[frames]]\nexposure_s = 1.0\nboresight_radec_deg = [56.75, 24.1]\n",
    /// )?;
    /// let renderer = Renderer::new(&scene, Catalog::embedded(), Backend::Cpu)?;
    /// let frame = renderer.render(0)?;
    /// assert_eq!(frame.pixels_dn.len(), 64 * 64);
    /// assert_eq!(frame, renderer.render(0)?, "the same frame, whatever was rendered before");
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn render(&self, index: usize) -> Result<Rendered, ImagingError> {
        self.check_light(index)?;
        let Sources { tracks, others, lights } = self.sources(index);
        let sky_e = self.sky_e(index);
        let (of_stars, of_others) = lights.split_at(tracks.len());
        let [of_stars, of_others] = [of_stars, of_others].map(FrameLight::from_iter);
        let frame = of_stars.with(&of_others);
        let exposure = self.exposure(index, &frame, &sky_e);
        let planes = self.spreader.planes(&frame);
        let chain = self.imager.noise_free(&exposure, &planes)?;
        let seen = |light: &StarLight| Ok(self.spreader.stamp(light, &self.imager)?.map(|stamp| Seen::new(self.scene, &chain, &stamp)));
        let seen = parallel::try_map::<_, _, ImagingError>(&lights, seen)?;
        let landed = |(seen, light): (&Option<Seen>, &StarLight)| {
            seen.as_ref().map_or_else(Landed::default, |seen| seen.landed(self.spreader.whole_e(light)))
        };
        let landed: Vec<Landed> = seen.iter().zip(&lights).map(landed).collect();
        let footprints = self.asked.footprints.then(|| self.footprints(&lights, &seen)).transpose()?;
        let binned = self.binned.as_ref().filter(|_| self.asked.pixel_shifts);
        let binned = binned.map(|binned| binned.noise_free(&exposure, &planes)).transpose()?;
        let whole = Chain { own: &chain, binned: binned.as_ref() };
        let shifts = if !self.asked.pixel_shifts {
            vec![None; tracks.len()]
        } else if whole.shapes_light() || self.even_spreader.is_some() || frame.filtered().is_some() {
            let even = self.even_spreader.as_ref().unwrap_or(&self.spreader);
            let light = Light { stars: &of_stars, others: &of_others, seen: &self.spreader, even };
            pixel_shifts(self.scene, &exposure, &whole, &light, &tracks)?
        } else {
            vec![Some(PixelShift::NONE); tracks.len()]
        };
        let stars = true_stars(self.scene, index, &tracks, &landed, &shifts);
        let true_lights = others.iter().zip(&landed[tracks.len()..]).map(|(other, landed)| TrueLight::new(index, other, *landed)).collect();
        let lit = self.on_pixels(&exposure, &frame)?;
        let exposure = FrameExposure { stars: lit.stars, sky_e: &lit.spread_e, ..exposure };
        let pixels_dn = self.counts(&exposure, &lit.planes)?.pixels_dn;
        let clean_e = self.asked.clean.then(|| self.clean_e(&exposure, &lit.planes)).transpose()?;
        let mask = if self.asked.mask {
            let stamp = |(other, light): (&OtherLight, &StarLight)| Ok((other.kind, self.spreader.stamp(light, &self.imager)?));
            let stamps = others.iter().zip(&lights[tracks.len()..]).map(stamp).collect::<Result<Vec<_>, ImagingError>>()?;
            let of_own = |own_dn: &[u16]| mask(&self.imager, &chain, &exposure, &lit.planes, own_dn, &stamps, self.own_width_px());
            Some(match self.scene.binning {
                None => {
                    let mut mask = of_own(&pixels_dn)?;
                    if let Some(dark) = &self.scene.dark_frame {
                        mask.iter_mut().zip(dark.hot()).for_each(|(flags, is_hot)| *flags |= if is_hot { MaskFlag::HOT } else { 0 });
                    }
                    mask
                }
                Some(binning) => {
                    let own = of_own(&vec![0; pixels_dn.len() * binning.factor * binning.factor])?;
                    let full_dn = self.scene.detector.joined(self.scene.binning).full_pixel_dn();
                    joined_mask(&own, self.own_width_px(), binning.factor, &pixels_dn, full_dn)
                }
            })
        } else {
            None
        };
        Ok(Rendered { pixels_dn, stars, lights: true_lights, clean_e, mask, footprints })
    }

    /// The expected electrons of exposure number `index`, without noise, row by row: stars and sky.
    ///
    /// # Panics
    /// If `index` is not below the number of exposures.
    pub fn expected_electrons(&self, index: usize) -> Result<Vec<f32>, ImagingError> {
        let frame: FrameLight = self.sources(index).lights.iter().collect();
        let sky_e = self.sky_e(index);
        let exposure = self.exposure(index, &frame, &sky_e);
        let lit = self.on_pixels(&exposure, &frame)?;
        self.clean_e(&FrameExposure { stars: lit.stars, sky_e: &lit.spread_e, ..exposure }, &lit.planes)
    }

    /// What the frame shows of each light.
    fn footprints(&self, lights: &[StarLight], seen: &[Option<Seen>]) -> Result<Vec<Footprint>, ImagingError> {
        let of_one = |(light, seen): (&StarLight, &Option<Seen>)| match seen {
            Some(seen) => Footprint::new(self.scene, &self.spreader, &self.imager, light, seen),
            None => Ok(Footprint::default()),
        };
        parallel::try_map_numbers(lights.len(), |number| of_one((&lights[number], &seen[number])))
    }

    /// Expected electrons of the frame's pixels.
    fn clean_e(&self, exposure: &FrameExposure<'_>, planes: &[PlaneLight<'_>]) -> Result<Vec<f32>, ImagingError> {
        match &self.binned {
            Some(binned) => binned.expected_electrons(exposure, planes),
            None => self.imager.electrons_after_with(Some(Stage::Light), exposure, planes),
        }
    }

    /// The counts of an exposure.
    fn counts(&self, exposure: &FrameExposure<'_>, planes: &[PlaneLight<'_>]) -> Result<Image16, ImagingError> {
        match (&self.binned, &self.scene.dark_frame) {
            (Some(binned), _) => binned.expose_with(exposure, planes),
            (None, Some(dark)) => self.imager.expose_on(exposure, planes, &dark.electrons),
            (None, None) => self.imager.expose_with(exposure, planes),
        }
    }

    /// Light of the sky on the detector's own pixels; empty: none but what is even.
    fn sky_e(&self, index: usize) -> Vec<f32> {
        let sky_e = self.scene.sky_light_e(index);
        match self.scene.binning {
            Some(binning) => binning.share_out(&sky_e, self.scene.camera.width_px),
            None => sky_e,
        }
    }

    /// Columns of the detector's own pixels.
    fn own_width_px(&self) -> usize {
        self.scene.own_psf.own_per_px * self.scene.camera.width_px
    }

    /// The light of a frame as it goes to the detector's own pixels.
    fn on_pixels<'b>(&'b self, exposure: &FrameExposure<'b>, frame: &'b FrameLight) -> Result<OnPixels<'b>, ImagingError> {
        on_pixels(frame, &self.spreader, exposure.sky_e, |lights| self.imager.behind_filters(exposure, lights))
    }

    fn exposure<'b>(&self, index: usize, frame: &'b FrameLight, sky_e: &'b [f32]) -> FrameExposure<'b> {
        let crate::scene::Exposure { exposure_s, telemetry, .. } = &*self.scene.exposures.get(index);
        let (frame_index, temperature_c) = (self.scene.frame_number(index), telemetry.temperature_c);
        FrameExposure { stars: &frame.stars, sky_e, exposure_s: *exposure_s, frame_index, temperature_c }
    }

    /// The width of the narrowest point spread, and how far outside the frame a star lights it, px.
    fn reach(&self, index: usize) -> (f64, f64) {
        /// Beyond so many widths lies less than 1e-9 of a Gaussian's light.
        const SIGMAS: f64 = 6.0;
        let fast_rad = self.scene.exposures.get(index).motion.fast_rad2().into_iter().fold(0.0, f64::max).sqrt();
        let jitter_px = fast_rad * self.scene.camera.focal_length_px;
        (self.scene.psf.smooth_px, self.spreader.margin_px() + SIGMAS * jitter_px)
    }

    /// Says no to an exposure whose starlight would take minutes: every star is put down at many places along its way, on many pixels each.
    fn check_light(&self, index: usize) -> Result<(), ImagingError> {
        /// Pixels lit, over all places: some 15 s of processor time.
        const MAX_LIT_PIXELS: f64 = 4e8;
        let (width_px, margin_px) = self.reach(index);
        let (tracks, each) = self.scene.some_star_tracks(self.catalog, index, width_px, margin_px);
        let lights = tracks.iter().map(|track| self.spreader.light(track));
        let places = each * lights.map(|light| light.places() as f64).sum::<f64>();
        let side_px = 2.0 * self.spreader.margin_px() * self.scene.own_psf.own_per_px as f64;
        let area_px = (side_px * side_px).ceil() as usize;
        if places * area_px as f64 <= MAX_LIT_PIXELS {
            return Ok(());
        }
        Err(ImagingError::TooMuchLight { index, places, area_px, most: MAX_LIT_PIXELS })
    }

    /// Everything that lights an exposure.
    fn sources(&self, index: usize) -> Sources {
        let (width_px, margin_px) = self.reach(index);
        let tracks = self.scene.star_tracks(self.catalog, index, width_px, margin_px);
        let others = self.scene.other_lights(index, &tracks);
        let mut lights: Vec<StarLight> = parallel::map(&tracks, |track| self.spreader.light(track));
        lights.extend(others.iter().map(|other| self.spreader.other(other)));
        if let Some(filters) = &self.scene.colour_filters {
            let of_stars: HashMap<u32, Option<f64>> = tracks.iter().map(|track| (track.hip, track.colour)).collect();
            let of_star = |other: &OtherLight| of_stars.get(&other.hip?).copied().flatten();
            let colours = tracks.iter().map(|track| track.colour).chain(others.iter().map(of_star));
            for (light, colour) in lights.iter_mut().zip(colours) {
                light.through = Some(filters.relative(colour, &self.scene.colour_response));
            }
        }
        Sources { tracks, others, lights }
    }
}

/// What lights an exposure.
struct Sources {
    /// The stars on their way over the frame, brightest first.
    tracks: Vec<StarTrack>,
    others: Vec<OtherLight>,
    /// The light of the stars, then that of the others.
    lights: Vec<StarLight>,
}
