//! A sample: the files that a frame becomes, from the recipe and its number alone.

use std::borrow::Cow;
use std::time::Instant;

use sha2::{Digest, Sha256};

use super::error::DatasetError;
use super::frame_key::FrameKey;
use super::frame_scene::FrameScene;
use super::image_files::{fits_rice, npy_f32, npy_u16, png8, png16};
use super::pixel_labels::{classes, distances, instances};
use super::plan::{DatasetPlan, hexadecimal};
use super::recipe::{ImageFormat, SampleMember};
use super::sample_labels::{SampleLabels, is_false_star, visible_stars};
use crate::catalog::Catalog;
use crate::recording::low_byte_first;
use crate::render::{ImagingError, PsfTables, Rendered, Renderer, StarsAlone};
use crate::scene::Scene;
use crate::statistics::order::sort_by_key;

/// A sample.
#[derive(Clone, Debug)]
pub struct DatasetSample {
    /// Its files in the order of their names: what stands behind the number of the frame and a dot, and the bytes.
    pub members: Vec<(&'static str, Vec<u8>)>,
    /// Its labels.
    pub labels: SampleLabels,
    /// Its scene.
    pub frame: FrameScene,
    /// Stars of the catalogue that light it.
    pub stars: u64,
    /// Other lights.
    pub lights: u64,
    /// Sum of its counts.
    pub sum_dn: u64,
    /// Pixels.
    pub pixels: u64,
}

impl DatasetPlan {
    /// Makes a sample. `tables` are kept from frame to frame and change nothing but the time that it takes.
    pub fn sample(&self, catalog: &Catalog, tables: &PsfTables, key: FrameKey) -> Result<DatasetSample, DatasetError> {
        let begun = Instant::now();
        let frame = self.frame_scene(key)?;
        let scene = self.scene_of(&frame)?;
        let (built, begun) = (ms_since(begun), Instant::now());
        let rendered = self.rendered(&scene, catalog, tables, key)?;
        let (lit, begun) = (ms_since(begun), Instant::now());
        let sample = self.files(frame, &scene, (&rendered, catalog))?;
        tracing::debug!(
            "frame {:09}: {} stars; scene {built:.2} ms, rendering {lit:.2} ms, labels and files {:.2} ms",
            key.number(),
            rendered.stars.len(),
            ms_since(begun)
        );
        Ok(sample)
    }

    fn wants(&self, member: SampleMember) -> bool {
        self.recipe.size.members.contains(&member)
    }

    /// Renders a frame.
    fn rendered(&self, scene: &Scene, catalog: &Catalog, tables: &PsfTables, key: FrameKey) -> Result<Rendered, DatasetError> {
        let wrong = |source| self.imaging_error(key, source);
        let renderer = Renderer::with_tables(scene, catalog, self.backend, tables).map_err(wrong)?;
        let renderer = renderer.with_pixel_shifts(false).with_footprints(true);
        let renderer = renderer.with_clean(self.wants(SampleMember::Clean)).with_masks(self.wants(SampleMember::Mask));
        renderer.render(0).map_err(wrong)
    }

    /// Stars of a frame, each by itself and without noise.
    pub(super) fn stars_alone(
        &self,
        catalog: &Catalog,
        tables: &PsfTables,
        key: FrameKey,
        wanted: &(dyn Fn(u32) -> bool + Sync),
    ) -> Result<StarsAlone, DatasetError> {
        let scene = self.scene_of(&self.frame_scene(key)?)?;
        let renderer = Renderer::with_tables(&scene, catalog, self.backend, tables).map_err(|source| self.imaging_error(key, source))?;
        renderer.stars_alone(0, wanted).map_err(|source| self.imaging_error(key, source))
    }

    fn imaging_error(&self, key: FrameKey, source: ImagingError) -> DatasetError {
        DatasetError::Imaging { path: self.path.clone(), key: key.number(), source }
    }

    /// The files of a rendered frame.
    fn files(&self, frame: FrameScene, scene: &Scene, (rendered, catalog): (&Rendered, &Catalog)) -> Result<DatasetSample, DatasetError> {
        let key = frame.key.number();
        let size = [scene.camera.width_px, scene.camera.height_px];
        let counts = counts(scene, rendered);
        let footprints = rendered.footprints.as_deref().unwrap_or_default();
        let bytes = low_byte_first(&counts);
        let of_scene = frame.sha256().map_err(|error| DatasetError::Encode { key, message: error.to_string() })?;
        let labels = SampleLabels::new(&frame, scene, (rendered, catalog), (of_scene, hexadecimal(&Sha256::digest(&bytes))));
        let json = serde_json::to_vec(&labels).map_err(|error| DatasetError::Encode { key, message: error.to_string() })?;
        let mut members = vec![("json", json)];
        let image = match self.recipe.size.image {
            ImageFormat::Png16 => png16(key, size, &counts)?,
            ImageFormat::Npy => npy_u16(size, &bytes),
            ImageFormat::FitsRice => fits_rice(&labels, &counts)?,
        };
        members.push((self.recipe.size.image.member(), image));
        if let Some(flags) = &rendered.mask {
            let (of_stars, of_lights) = footprints.split_at(rendered.stars.len());
            let of_false_stars = rendered.lights.iter().zip(of_lights).filter(|(light, _)| is_false_star(light));
            members.push(("mask.png", png8(key, size, &classes(flags, of_stars.iter(), of_false_stars.map(|(_, footprint)| footprint)))?));
        }
        if self.wants(SampleMember::Distance) {
            members.push(("distance.png", png8(key, size, &distances(size, visible_stars(size, rendered, footprints)))?));
        }
        if self.wants(SampleMember::Instances) {
            members.push(("instances.png", png16(key, size, &instances(counts.len(), footprints))?));
        }
        if let Some(clean_e) = &rendered.clean_e {
            members.push(("clean.npy", npy_f32(size, clean_e)));
        }
        sort_by_key(&mut members, |(name, _)| *name);
        Ok(DatasetSample {
            members,
            labels,
            frame,
            stars: rendered.stars.len() as u64,
            lights: rendered.lights.len() as u64,
            sum_dn: counts.iter().map(|count| u64::from(*count)).sum(),
            pixels: counts.len() as u64,
        })
    }
}

fn ms_since(begun: Instant) -> f64 {
    1e3 * begun.elapsed().as_secs_f64()
}

/// The counts as a recording of the same scene has them: those of converters of 8 bits end at 255.
fn counts<'r>(scene: &Scene, rendered: &'r Rendered) -> Cow<'r, [u16]> {
    let is_of_bytes = scene.detector.bits <= 8 && scene.detector.joined(scene.binning).top_dn() <= 255.0;
    if !is_of_bytes {
        return Cow::Borrowed(&rendered.pixels_dn);
    }
    rendered.pixels_dn.iter().map(|count| (*count).min(u8::MAX.into())).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::frame_key::DatasetSplit;
    use crate::dataset::plan::tests::{SCENE, plan_of, recipe};
    use crate::render::Backend;

    const FRAME: FrameKey = FrameKey { split: DatasetSplit::Train, index: 3 };

    fn labels(sample: &DatasetSample) -> serde_json::Value {
        serde_json::from_slice(&sample.members.iter().find(|(name, _)| *name == "json").unwrap().1).unwrap()
    }

    #[test]
    fn a_sample_has_the_same_files_and_the_same_columns_whatever_is_on_it() {
        let hard = "[hard]\nno_stars = 0.5\nfalse_stars = { share = 0.5, count = [1, 3] }\n";
        let plan = plan_of(&recipe(hard), SCENE).unwrap();
        let (catalog, tables) = (Catalog::embedded(), PsfTables::default());
        let samples: Vec<DatasetSample> =
            (0..8).map(|index| plan.sample(catalog, &tables, FrameKey { split: DatasetSplit::Train, index }).unwrap()).collect();
        let shape = |value: &serde_json::Value| -> Vec<String> {
            let keys = value.as_object().unwrap().keys().cloned();
            keys.chain(value["lights"].as_object().unwrap().keys().cloned()).collect()
        };
        let first = labels(&samples[0]);
        assert!(samples.iter().any(|sample| sample.stars == 0) && samples.iter().any(|sample| sample.lights > 0));
        for sample in &samples {
            let labels = labels(sample);
            assert_eq!(shape(&labels), shape(&first));
            assert_eq!(sample.members.iter().map(|(name, _)| *name).collect::<Vec<_>>(), ["distance.png", "image.png", "json", "mask.png"]);
            assert!(!labels.to_string().contains("null"));
            for (name, column) in labels["lights"].as_object().unwrap() {
                assert_eq!(column.as_array().unwrap().len() as u64, sample.stars + sample.lights, "{name}");
            }
        }
    }

    #[test]
    fn the_bound_is_that_of_a_lone_gaussian() {
        // One star of the Pleiades in a narrow field, far above the background: σ/√N, widened by the pixel and the background.
        let scene = "format = \"boresight-scene/1\"\ncamera = { width_px = 64, height_px = 64, focal_length_px = 4000.0 }\n\
                     detector = { psf_sigma_px = 1.5, read_noise_e = 0.0, full_well_e = 1e9, zero_point_e_per_s = 1e7 }\n\
                     sky = { physics = \"none\", background_e_per_px_s = 0.001, faintest_magnitude = 5.0 }\n\
                     [[frames]]\nexposure_s = 1.0\nboresight_radec_deg = [56.8712, 24.1051]\n";
        let plan = plan_of(&recipe(""), scene).unwrap();
        let labels = labels(&plan.sample(Catalog::embedded(), &PsfTables::default(), FRAME).unwrap());
        let lights = &labels["lights"];
        let of = |name: &str| lights[name][0].as_f64().unwrap();
        let expected = (1.5_f64.powi(2) + 1.0 / 12.0).sqrt() / of("electrons_landed").sqrt();
        for axis in ["crlb_x_px", "crlb_y_px"] {
            assert!((of(axis) / expected - 1.0).abs() < 0.05, "{axis} = {} instead of {expected}", of(axis));
        }
        assert!(of("snr") > 100.0 && lights["visible"][0] == true);
        let (left, right, x) = (of("box_left_px"), of("box_right_px"), of("x_px"));
        assert!(left < x && x < right && (right - left - 2.0 * 1.96 * 1.5).abs() < 2.0, "{left} … {right} about {x}");
    }

    #[test]
    fn a_sample_is_what_simulate_renders_from_the_scene_of_its_frame() {
        let draws = "[[draw]]\nper = \"frame\"\npath = \"frames.rate_deg_s\"\nball = { radius = 0.5 }\n\
                     [[draw]]\nper = \"camera\"\npath = \"effects.hot-pixels.hot_per_million\"\nuniform = [1000, 2000]\n";
        let plan = plan_of(&recipe(draws), SCENE).unwrap();
        let sample = plan.sample(Catalog::embedded(), &PsfTables::default(), FRAME).unwrap();
        let text = toml::to_string(&plan.frame_scene(FRAME).unwrap().scene).unwrap();
        let scene = Scene::parse("s.toml", &text).unwrap();
        let rendered = Renderer::new(&scene, Catalog::embedded(), Backend::Cpu).unwrap().render(0).unwrap();
        let (_, image) = sample.members.iter().find(|(name, _)| *name == "image.png").unwrap();
        assert_eq!(image::load_from_memory(image).unwrap().as_luma16().unwrap().as_raw(), &rendered.pixels_dn);
        assert_eq!(labels(&sample)["scene_sha256"], hexadecimal(&Sha256::digest(&text)), "of the scene that is printed");
        // Another frame of the camera has the same hot pixels and other noise.
        let other = plan.sample(Catalog::embedded(), &PsfTables::default(), FrameKey { index: 4, ..FRAME }).unwrap();
        let file = |sample: &DatasetSample, name: &str| sample.members.iter().find(|(own, _)| *own == name).unwrap().1.clone();
        let hot = |sample: &DatasetSample| -> Vec<usize> {
            let mask = image::load_from_memory(&file(sample, "mask.png")).unwrap().into_luma8();
            mask.as_raw().iter().enumerate().filter(|(_, class)| **class == 7).map(|(pixel, _)| pixel).collect()
        };
        assert!(!hot(&sample).is_empty() && !hot(&other).is_empty());
        assert_ne!(file(&sample, "image.png"), file(&other, "image.png"));
        assert!(labels(&sample)["seed"] == labels(&other)["seed"]);
    }
}
