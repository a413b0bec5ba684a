//! Tables of point spreads that are kept from scene to scene: working them out takes longer than a small frame.

use std::sync::{Arc, Mutex, PoisonError};

use crate::effects::pixel::Atlas;
use crate::scene::{Psf, PsfKind};

/// Tables that were worked out. What is rendered does not depend on them: a scene whose images are others makes its own.
#[derive(Debug, Default)]
pub struct PsfTables {
    atlases: Mutex<Vec<(String, Atlas)>>,
    images: Mutex<Vec<(String, Arc<[f32]>)>>,
}

impl PsfTables {
    /// All of them together hold at most this, unless a single one is larger.
    const MAX_BYTES: usize = 96 << 20;
    /// Single images, which atlases share.
    const MAX_IMAGE_BYTES: usize = 16 << 20;

    /// The tables of these images. Images given point by point are not kept, since nothing short tells one from another.
    pub(super) fn get_or_make(&self, psf: &Psf, make: impl FnOnce() -> Atlas) -> Atlas {
        if matches!(psf.kind, PsfKind::Sampled(_)) {
            return make();
        }
        let name = format!("{psf:?}");
        let known = self
            .atlases
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .iter()
            .find(|(other, _)| *other == name)
            .map(|(_, atlas)| atlas.clone());
        if let Some(atlas) = known {
            return atlas;
        }
        let atlas = make();
        let mut all = self.atlases.lock().unwrap_or_else(PoisonError::into_inner);
        all.push((name, atlas.clone()));
        let bytes = |atlas: &Atlas| size_of_val::<[f32]>(&atlas.values);
        while all.len() > 1 && all.iter().map(|(_, atlas)| bytes(atlas)).sum::<usize>() > Self::MAX_BYTES {
            all.remove(0);
        }
        atlas
    }

    /// The table of a single image of this name, which says all that it depends on: two cameras with less and with more of a coma show the same images,
    /// each at the place that is opposite.
    pub(super) fn image(&self, name: String, make: impl FnOnce() -> Vec<f32>) -> Arc<[f32]> {
        let known = |all: &[(String, Arc<[f32]>)]| all.iter().find(|(other, _)| *other == name).map(|(_, table)| Arc::clone(table));
        if let Some(table) = known(&self.images.lock().unwrap_or_else(PoisonError::into_inner)) {
            return table;
        }
        let table: Arc<[f32]> = Arc::from(make());
        let mut all = self.images.lock().unwrap_or_else(PoisonError::into_inner);
        all.push((name, Arc::clone(&table)));
        while all.iter().map(|(_, table)| size_of_val::<[f32]>(table)).sum::<usize>() > Self::MAX_IMAGE_BYTES {
            all.remove(0);
        }
        table
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::{Backend, Renderer};
    use crate::scene::Scene;

    #[test]
    fn tables_are_made_once_for_each_image_and_change_nothing() {
        let scene = |fwhm: f64| {
            let text = format!(
                "format = \"boresight-scene/1\"\ncamera = {{ width_px = 64, height_px = 64, focal_length_px = 900.0 }}\n\
                 psf = {{ kind = \"moffat\", parameters = {{ fwhm_px = {fwhm}, beta = 3.5 }} }}\n[[frames]]\nexposure_s = 1.0\nboresight_radec_deg = [56.75, 24.1]\n"
            );
            Scene::parse("pleiades.toml", &text).unwrap()
        };
        let tables = PsfTables::default();
        let catalog = crate::catalog::Catalog::embedded();
        for fwhm in [2.0, 2.5, 2.0] {
            let scene = scene(fwhm);
            let with = Renderer::with_tables(&scene, catalog, Backend::Cpu, &tables).unwrap().render(0).unwrap();
            assert_eq!(with, Renderer::new(&scene, catalog, Backend::Cpu).unwrap().render(0).unwrap());
        }
        let kept = tables.atlases.lock().unwrap();
        assert_eq!(kept.len(), 2);
        assert!(!Arc::ptr_eq(&kept[0].1.values, &kept[1].1.values));
    }
}
