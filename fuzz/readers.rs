//! The readers that are fuzzed, their good inputs, and how an input is given to them.

use std::path::Path;

use boresight::calibrate::trial::Trial;
use boresight::calibrate::{CalibrateOptions, Calibration, calibrate, map};
use boresight::catalog::{Catalog, import_catalog};
use boresight::dataset::{DatasetPlan, DatasetSplit, FrameKey};
use boresight::diagnose::DiagnoseOptions;
use boresight::exchange;
use boresight::gpu::Backend;
use boresight::guard::guarded;
use boresight::recording::{OpenOptions, Plane, Recording};
use boresight::render::{Renderer, TrueStar};
use boresight::scene::{DEMO_TOML, Scene};

use super::zoo::{self, File};

const MANIFEST: &str = "format = \"star-recording/1\"\nstars = \"stars.csv\"\n[camera]\nwidth_px = 12\nheight_px = 10\nfocal_length_px = 80.5\n[site]\nlatitude_deg = 52.0\nlongitude_deg = 4.5\n[mount]\nkind = \"fixed\"\n[[frames]]\ntime_utc = \"2026-03-01T22:15:07Z\"\nexposure_s = 0.2\ncamera_from_icrs = [0.0, 0.0, 0.0, 1.0]\n[[frames]]\ntime_utc = \"2026-03-01T22:15:08Z\"\nheater_current_a = 0.5\n";
const STARS: &str = "frame,x_px,y_px,flux_e,sigma_x_px,sigma_y_px,cov_xy_px2,hip,ra_deg,dec_deg\n0,1.5,2.5,800,0.1,0.1,0.001,32349,101.28,-16.7\n1,3,4,,,,,,,\n";
const CATALOGUE: &str = "hip,ra_deg,dec_deg,magnitude,pm_ra_mas_yr,pm_dec_mas_yr,parallax_mas,bv\n1,10.5,-20.25,4.5,100.0,-3.5,12.0,0.6\n2,200.0,60.0,2.25,,,,\n";
const OPTIONS: &str = "method = \"bundle\"\nsolve = [\"f\", \"k1\"]\nphysics = [\"proper-motion\"]\nalpha = 0.01\nnulls = 200\nseed = 7\n";
const RECIPE: &str = "format = \"boresight-recipe/1\"\nname = \"tracker\"\nseed = 7\nscene = \"preset:cubesat-tracker\"\nlicence = \"CC0-1.0\"\n[size]\nframes = { train = 512, validation = 64, test = 64 }\nframes_per_shard = 32\nframes_per_recording = 2\nimage = \"png16\"\nmembers = [\"mask\", \"distance\"]\n[splits]\napart_by = [\"camera\", \"sky\"]\nguard_deg = 8.0\n[cameras]\ntrain = 8\nvalidation = 2\ntest = 2\n[[draw]]\nper = \"camera\"\npath = \"camera.focal_length_px\"\nnormal = { mean = 7270.0, sigma = 15.0, within = [7230.0, 7310.0] }\n[[draw]]\nper = \"frame\"\npath = \"frames.rate_deg_s\"\nball = { radius = 1.0 }\nspread = \"even\"\n[[draw]]\nper = \"frame\"\npath = \"effects.zodiacal-light\"\nprobability = 0.3\n[hard]\nno_stars = 0.02\nfalse_stars = { share = 0.1, count = [1, 20] }\ntwins = 0.05\n";

/// What is fuzzed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Reader {
    Fits,
    PackedFits,
    Png,
    Tiff,
    Jpeg,
    Bmp,
    Pgm,
    Calibration,
    Manifest,
    StarList,
    Cameras,
    Catalogue,
    Scene,
    Rendered,
    Recipe,
    Options,
}

impl Reader {
    pub(crate) const ALL: [Self; 16] = [
        Self::Fits,
        Self::PackedFits,
        Self::Png,
        Self::Tiff,
        Self::Jpeg,
        Self::Bmp,
        Self::Pgm,
        Self::Calibration,
        Self::Manifest,
        Self::StarList,
        Self::Cameras,
        Self::Catalogue,
        Self::Scene,
        Self::Rendered,
        Self::Recipe,
        Self::Options,
    ];

    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Fits => "FITS",
            Self::PackedFits => "FITS, tile-compressed",
            Self::Png => "PNG",
            Self::Tiff => "TIFF",
            Self::Jpeg => "JPEG",
            Self::Bmp => "BMP",
            Self::Pgm => "PGM",
            Self::Calibration => "calibrate.json",
            Self::Manifest => "recording.toml",
            Self::StarList => "star lists",
            Self::Cameras => "cameras of other programs",
            Self::Catalogue => "catalogues",
            Self::Scene => "SCENE.toml",
            Self::Rendered => "a scene's first frame",
            Self::Recipe => "RECIPE.toml",
            Self::Options => "options in files",
        }
    }

    /// Good inputs.
    pub(crate) fn seeds(self) -> Vec<File> {
        let of = |start: &str| zoo::zoo().into_iter().filter(|(name, bytes)| name.starts_with(start) && bytes.len() > 40).collect();
        let one = |name: &str, text: &str| vec![(name.to_owned(), text.as_bytes().to_vec())];
        match self {
            Self::Fits => of("fits-"),
            Self::PackedFits => of("packed-"),
            Self::Png => of("png-"),
            Self::Tiff => of("tiff-"),
            Self::Jpeg => of("jpeg-"),
            Self::Bmp => of("bmp-"),
            Self::Pgm => of("pgm-"),
            Self::Calibration => vec![("calibrate.json".to_owned(), calibration())],
            Self::Manifest => one("recording.toml", MANIFEST),
            Self::StarList => one("stars.csv", STARS),
            Self::Cameras => vec![
                ("opencv.yml".to_owned(), include_bytes!("../tests/fixtures/exchange/opencv.yml").to_vec()),
                ("opencv_fisheye.yml".to_owned(), include_bytes!("../tests/fixtures/exchange/opencv_fisheye.yml").to_vec()),
                ("mrcal.cameramodel".to_owned(), include_bytes!("../tests/fixtures/exchange/mrcal.cameramodel").to_vec()),
                ("tetra3rs.json".to_owned(), include_bytes!("../tests/fixtures/exchange/tetra3rs.json").to_vec()),
                ("sip.wcs".to_owned(), include_bytes!("../tests/fixtures/exchange/sip.wcs").to_vec()),
                ("tpv.wcs".to_owned(), include_bytes!("../tests/fixtures/exchange/tpv.wcs").to_vec()),
            ],
            Self::Catalogue => one("stars.csv", CATALOGUE),
            Self::Scene => one("scene.toml", DEMO_TOML),
            Self::Rendered => vec![
                ("ground.toml".to_owned(), include_bytes!("scenes/ground.toml").to_vec()),
                ("orbit.toml".to_owned(), include_bytes!("scenes/orbit.toml").to_vec()),
            ],
            Self::Recipe => one("recipe.toml", RECIPE),
            Self::Options => one("options.toml", OPTIONS),
        }
    }

    /// Gives an input to the reader, as the verbs do; the error's sentence if it is refused.
    pub(crate) fn read(self, folder: &Path, (name, bytes): &File) -> Result<(), String> {
        let path = folder.join(name);
        std::fs::write(&path, bytes).map_err(|error| error.to_string())?;
        let text = || String::from_utf8_lossy(bytes).into_owned();
        let words = |error: &dyn std::fmt::Display| error.to_string();
        match self {
            Self::Manifest | Self::StarList => {
                for (other, good) in [("recording.toml", MANIFEST), ("stars.csv", STARS)] {
                    if other != name {
                        std::fs::write(folder.join(other), good).map_err(|error| error.to_string())?;
                    }
                }
                let recording = Recording::open(&[folder]).map_err(|error| words(&error))?;
                let _ = (recording.nominal_camera(), recording.common_size(), recording.observations());
                Ok(())
            }
            Self::Calibration => {
                let read = guarded(|| serde_json::from_slice::<Calibration>(bytes)).map_err(|error| words(&error))?;
                let calibration = read.map_err(|error| format!("this is no calibration: {error}"))?;
                let _ = map(&calibration.with_stored_columns(), 5);
                Ok(())
            }
            Self::Cameras => {
                let import = || exchange::import(name, bytes, None, None).map(|_| ());
                guarded(import).map_err(|error| words(&error))?.map_err(|error| words(&error))
            }
            Self::Catalogue => {
                let own = guarded(|| Catalog::from_file(&path)).map_err(|error| words(&error))?;
                let joined = guarded(|| import_catalog(std::slice::from_ref(&path), 99.0)).map_err(|error| words(&error))?;
                own.map(|_| ()).or(joined.map(|_| ())).map_err(|error| words(&error))
            }
            Self::Scene => Scene::parse("scene.toml", &text()).map(|_| ()).map_err(|error| words(&error)),
            Self::Rendered => {
                let scene = Scene::parse("scene.toml", &text()).map_err(|error| words(&error))?;
                let renderer = Renderer::new(&scene, Catalog::embedded(), Backend::Cpu).map_err(|error| words(&error))?;
                let rendered = renderer.render(0).map_err(|error| words(&error))?;
                let is_told = |star: &TrueStar| {
                    [star.x_px, star.y_px, star.x_mean_px, star.y_mean_px, star.electrons_landed, star.snr]
                        .iter()
                        .all(|number| number.is_finite())
                };
                if rendered.stars.iter().all(is_told) { Ok(()) } else { Err("FAULT: a truth that is no number".to_owned()) }
            }
            Self::Recipe => {
                let plan = DatasetPlan::parse("recipe.toml", &text(), folder).map_err(|error| words(&error))?;
                let first = DatasetSplit::ALL.into_iter().find(|split| plan.recipe.size.frames.of(*split) > 0);
                let Some(split) = first else { return Err("FAULT: a dataset without a frame".to_owned()) };
                let scene = plan.frame_scene(FrameKey { split, index: 0 }).and_then(|frame| plan.scene_of(&frame));
                scene.map(|_| ()).map_err(|error| words(&error))
            }
            Self::Options => {
                let calibrate = guarded(|| toml::from_str::<CalibrateOptions>(&text())).map_err(|error| words(&error))?;
                let diagnose = guarded(|| toml::from_str::<DiagnoseOptions>(&text())).map_err(|error| words(&error))?;
                calibrate.map(|_| ()).or(diagnose.map(|_| ())).map_err(|error| error.message().to_owned())
            }
            _ => {
                let mut last = Err("not read".to_owned());
                for plane in [None, Some(Plane::Index(1)), Some(Plane::Colours)] {
                    let read = || {
                        let recording = Recording::open_with(&[&path], OpenOptions { plane, ..OpenOptions::default() })?;
                        recording.load_masked(0).map(|masked| masked.frame.pixels_dn.iter().all(|pixel| pixel.is_finite()))
                    };
                    last = match read() {
                        Ok(true) => return Ok(()),
                        Ok(false) => return Err("FAULT: a pixel without a value was handed on".to_owned()),
                        Err(error) => Err(words(&error)),
                    };
                }
                last
            }
        }
    }
}

/// A calibration as its verb writes it.
fn calibration() -> Vec<u8> {
    let night = Trial { frames: 3, stars_per_frame: 12, ..Trial::published() }.night(Catalog::embedded(), 1);
    let solved = calibrate(&night.control_points, &CalibrateOptions { held_out: false, ..CalibrateOptions::default() });
    solved.ok().and_then(|calibration| serde_json::to_vec(&calibration).ok()).unwrap_or_default()
}
