//! `boresight effects --pictures`: what every effect does to a frame, as pictures.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;

use anyhow::{Context, Result, bail};
use boresight::catalog::Catalog;
use boresight::effects::optics::tables::IMAGE_KINDS;
use boresight::effects::pixel::{PLANE_SPREADS, pixel_effect};
use boresight::effects::sky::glow::SKY_GLOWS;
use boresight::effects::{ParameterSpec, displacement};
use boresight::imaging::Backend;
use boresight::recording::write_file;
use boresight::render::{Renderer, TrueStar};
use boresight::report::{self, OffOn};
use boresight::scene::Scene;

use super::output;

/// The scene that the pictures change: three exposures an hour apart of the belt of Orion, without noise.
const SCENE: &str = r#"
format = "boresight-scene/1"
seed = 5
camera = { width_px = 256, height_px = 256, focal_length_px = 700.0 $CAMERA }
detector = { psf_sigma_px = 1.2, zero_point_e_per_s = 4e5, gain_e_per_dn = 1.0, read_noise_e = 0.0, full_well_e = 1e6 $DETECTOR }
sky = { background_e_per_px_s = $BACKGROUND, faintest_magnitude = 8.0, physics = "none" }
site = { latitude_deg = 45.0, longitude_deg = 10.0, pressure_hpa = 1000.0, temperature_c = 10.0 }
$MORE
$FRAMES
"#;

/// One exposure of it: middle, temperature of the optics, pressure, rate.
const FRAME: &str = r#"
[[frames]]
time_utc = "$HOUR:00:00Z"
exposure_s = 1.0
boresight_radec_deg = [83.8, -1.2]
temperature_c = $TEMPERATURE
pressure_hpa = $PRESSURE
velocity_km_s = [-28.0, 8.0, 4.0]
$RATE
"#;

/// The exposure that is shown: the last, which is farthest from the mean in everything that telemetry tells.
const SHOWN: usize = 2;

/// Sizes that show more than the typical ones on so small a frame.
const SIZES: &[(&str, &[(&str, f64)])] = &[
    ("proper-motion", &[("epoch_offset_yr", 200.0)]),
    ("parallax", &[("amplitude", 100.0)]),
    ("light-deflection", &[("amplitude", 1000.0)]),
    ("time-tag", &[("offset_s", 60.0)]),
    ("brown-conrady", &[("k1", 2e-7), ("p1", 1e-6), ("p2", -1e-6)]),
    ("kannala-brandt", &[("k1_theta", -0.4)]),
    ("sensor-step", &[("line_px", 100.0)]),
    ("edge-roll-off", &[("length_px", 20.0)]),
    ("rolling-shutter", &[("line_time_us", 400.0)]),
    ("field-stop", &[("radius_px", 110.0)]),
    ("vignetting", &[("loss_at_corner", 0.5)]),
    ("hot-pixels", &[("level_e_per_px_s", 3000.0)]),
    ("blooming", &[("full_well_e", 8000.0)]),
    ("nonlinearity", &[("full_well_e", 4e4)]),
    ("charge-transfer-inefficiency", &[("full_well_e", 4e4)]),
    ("brighter-fatter", &[("shift_px_per_e", 2e-6)]),
    ("crosstalk", &[("relative", 0.005)]),
    ("banding", &[("row_sigma_e", 4.0), ("column_sigma_e", 2.0)]),
    ("dnl", &[("dnl_dn", 0.8), ("gain_e_per_dn", 1.0)]),
    ("jpeg", &[("table_scale_dn", 2.0)]),
    ("overshoot", &[("tail_relative", 0.03), ("tail_px", 2.0)]),
    ("adc", &[("saturation_dn", 4095.0), ("gain_e_per_dn", 1.0), ("full_well_e", 1e6)]),
    ("read-noise", &[("read_noise_e", 5.0)]),
];

/// Where a typical parameter is what the scene's detector has anyway.
const OF_DETECTOR: &[&str] = &["gain_e_per_dn", "bias_dn", "saturation_dn", "full_well_e"];

/// What a scene says in tables of its own: what is added to `[detector]`, and to the scene.
const WRITTEN: &[(&str, &str, &str)] = &[
    (
        "quantum-efficiency",
        ", quantum_efficiency = { wavelengths_nm = [350.0, 500.0, 600.0, 800.0, 1000.0], values = [0.2, 0.6, 0.55, 0.3, 0.05] }",
        "",
    ),
    (
        "colour-filters",
        ", colour_filters = { relative_per_mag = 0.2 }",
        "[[effects]]\nid = \"bayer\"\nparameters = { red_relative = 0.6, blue_relative = 0.5 }\n",
    ),
    ("ghosts", "", "[[ghosts]]\nscale = -0.8\nfraction = 0.01\nradius_px = 14.0\nobstruction = 0.3\n"),
    (
        "streaks",
        "",
        "[[streaks]]\nkind = \"meteor\"\nframe = 2\nstart_px = [60.0, 200.0]\nend_px = [190.0, 90.0]\nelectrons = 4e5\nlight_curve = [2.0, 1.0]\n",
    ),
    ("cosmic-rays", "", "[cosmic_rays]\nexpected_per_s = 25.0\n"),
];

/// What has no picture of its own, and why.
pub(crate) const WITHOUT_PICTURE: &[(&str, &str)] = &[
    ("stray-light", "in the pixels: stray-light-on-pixels.png; the shift follows a slope that is measured"),
    ("pinhole", "every other picture is taken through it"),
    ("gaussian-psf", "every other picture is made of it"),
    ("gaussian-image", "the same image from a table"),
    ("disc-psf", "ghosts are discs of it: ghosts.png"),
    ("atlas-psf", "it shows what its tables hold: airy-image, moffat-image, zernike-image"),
    ("sampled-image", "it shows what its file holds"),
];

/// A scene with and without something.
struct Pair {
    off: String,
    on: String,
    /// Random stages of the chain that are not taken out.
    noise: Option<&'static str>,
    /// What is on, in words.
    summary: String,
}

/// The parts of the scene that change.
#[derive(Clone, Default)]
struct Parts {
    camera: String,
    detector: String,
    no_background: bool,
    more: String,
    rate: String,
    dawn: bool,
}

impl Parts {
    fn text(&self) -> String {
        // A night of the full Moon, and a morning in autumn with the Sun 10° below the horizon.
        let hours = if self.dawn {
            ["2026-09-20T02", "2026-09-20T03", "2026-09-20T04"]
        } else {
            ["2026-01-01T00", "2026-01-01T01", "2026-01-01T02"]
        };
        let frame = |(number, hour): (usize, &str)| {
            FRAME
                .replace("$HOUR", hour)
                .replace("$TEMPERATURE", &format!("{:.1}", 20.0 * number as f64))
                .replace("$PRESSURE", &format!("{:.1}", 1000.0 - 100.0 * number as f64))
                .replace("$RATE", &self.rate)
        };
        let frames: String = hours.into_iter().enumerate().map(frame).collect();
        SCENE
            .replace("$CAMERA", &self.camera)
            .replace("$DETECTOR", &self.detector)
            .replace("$BACKGROUND", if self.no_background { "0.0" } else { "30.0" })
            .replace("$MORE", &self.more)
            .replace("$FRAMES", &frames)
    }
}

/// The parameters that a picture shows.
fn shown(id: &str, specs: &[ParameterSpec], skip: &[&str]) -> BTreeMap<&'static str, f64> {
    let chosen = SIZES.iter().find(|(known, _)| *known == id).map_or(&[][..], |(_, sizes)| sizes);
    let value = |spec: &ParameterSpec| chosen.iter().find(|(name, _)| *name == spec.name).map(|(_, value)| *value);
    let wanted = specs.iter().filter(|spec| value(spec).is_some() || !skip.contains(&spec.name));
    wanted.map(|spec| (spec.name, value(spec).unwrap_or(spec.typical))).collect()
}

fn inline(parameters: &BTreeMap<&str, f64>) -> String {
    parameters.iter().map(|(name, value)| format!("{name} = {value:?}")).collect::<Vec<_>>().join(", ")
}

/// The scenes of an effect that `boresight effects` lists; `acts_on` as it says there.
fn pair(id: &str, acts_on: &str) -> Result<Pair> {
    let (mut off, mut on) = (Parts::default(), Parts::default());
    let mut noise = None;
    if let Some((_, detector, more)) = WRITTEN.iter().find(|(written, ..)| *written == id) {
        (on.detector, on.more) = ((*detector).to_owned(), (*more).to_owned());
        let summary = format!("{}{}", detector.trim_start_matches(", "), more.trim().replace('\n', ", "));
        return Ok(Pair { off: off.text(), on: on.text(), noise, summary });
    }
    let name = id.replace('-', "_");
    let specs = |id: &str| displacement(id).map_or(&[][..], |effect| effect.parameters());
    let parameters = match acts_on {
        "projection" => {
            let own = shown(id, specs(id), &["x0", "y0", "f"]);
            on.camera = format!(", projection = {id:?}");
            if id == "kannala-brandt" {
                let values = ["k1_theta", "k2_theta", "k3_theta", "k4_theta"].map(|name| own.get(name).copied().unwrap_or_default());
                let _ = write!(on.camera, ", projection_parameters = {values:?}");
            }
            own
        }
        "star image" => {
            let kind = IMAGE_KINDS.iter().find(|kind| format!("{}-image", kind.id()) == id);
            let spread = PLANE_SPREADS.iter().find(|spread| spread.id() == name);
            let (kind, mut own) = match (kind, spread) {
                (Some(kind), _) => (kind.id(), shown(id, kind.parameters(), &[])),
                (None, Some(spread)) => ("elliptic-gaussian", shown(id, spread.parameters(), &[])),
                (None, None) => bail!("{id}: no picture shows this image"),
            };
            own.retain(|_, value| *value != 0.0);
            on.more = format!("[psf]\nkind = {kind:?}\nparameters = {{ {} }}\n", inline(&own));
            own
        }
        "sky between the stars" => {
            let glow = SKY_GLOWS.iter().find(|glow| glow.id() == id);
            (off.dawn, on.dawn) = (id == "twilight", id == "twilight");
            on.more = format!("[[effects]]\nid = {id:?}\n");
            shown(id, glow.map_or(&[][..], |glow| glow.parameters()), &[])
        }
        "pixels" | "charge between pixels" => {
            let Some(effect) = pixel_effect(&name) else { bail!("{id}: no picture shows this effect") };
            let own = shown(id, effect.parameters(), OF_DETECTOR);
            noise = ["photon-noise", "read-noise"].into_iter().find(|noisy| *noisy == id);
            match id {
                "background" => off.no_background = true,
                "photon-noise" => {}
                _ => on.more = format!("[[effects]]\nid = {id:?}\nparameters = {{ {} }}\n", inline(&own)),
            }
            own
        }
        _ if id == "brown-conrady" => {
            let own = shown(id, specs(id), &[]);
            on.camera = format!(", {}", inline(&own));
            own
        }
        _ => {
            let own = shown(id, specs(id), &[]);
            if id == "rolling-shutter" {
                (off.rate, on.rate) = ("rate_deg_s = [0.0, 0.5, 0.0]".into(), "rate_deg_s = [0.0, 0.5, 0.0]".into());
            }
            on.more = format!("[[effects]]\nid = {id:?}\nparameters = {{ {} }}\n", inline(&own));
            own
        }
    };
    Ok(Pair { off: off.text(), on: on.text(), noise, summary: inline(&parameters) })
}

/// A frame: its counts, its stars, its columns and rows.
type Taken = (Vec<f32>, Vec<TrueStar>, (usize, usize));

/// Takes the frame of a scene.
fn frame(text: &str, noise: Option<&str>) -> Result<Taken> {
    let mut scene = Scene::parse("the scene of the pictures", text)?;
    scene.pixel_effects.retain(|effect| match effect.id.as_str() {
        random @ ("photon_noise" | "read_noise") => noise.is_some_and(|kept| kept.replace('-', "_") == random),
        _ => true,
    });
    let rendered = Renderer::new(&scene, Catalog::embedded(), Backend::Cpu)?.render(SHOWN)?;
    let pixels = rendered.pixels_dn.iter().map(|count| f32::from(*count)).collect();
    Ok((pixels, rendered.stars, (scene.camera.width_px, scene.camera.height_px)))
}

/// The largest shift of a star that is in both frames, px.
fn largest_shift_px(off: &[TrueStar], on: &[TrueStar]) -> f64 {
    let before: BTreeMap<u32, &TrueStar> = off.iter().map(|star| (star.hip, star)).collect();
    let shifts = on
        .iter()
        .filter_map(|star| before.get(&star.hip).map(|old| (star.x_mean_px - old.x_mean_px).hypot(star.y_mean_px - old.y_mean_px)));
    shifts.fold(0.0, f64::max)
}

/// Writes a picture of each effect (`(id, what it acts on)`), a page that holds them, and returns a table of them.
pub(crate) fn write(directory: &Path, effects: &[(String, &'static str)]) -> Result<String> {
    std::fs::create_dir_all(directory).with_context(|| format!("creating {}", directory.display()))?;
    let bar = output::progress("pictures", effects.len());
    let (mut rows, mut page) = (Vec::new(), String::new());
    for (id, acts_on) in effects {
        bar.inc(1);
        // Some causes are both: a displacement for the calibrator, and what happens to the charge.
        let is_pixels = acts_on.contains("pixels");
        let is_second = is_pixels && displacement(id).is_some() && pixel_effect(&id.replace('-', "_")).is_some();
        if let Some((_, why)) = WITHOUT_PICTURE.iter().find(|(known, _)| known == id && !is_second) {
            rows.push(vec![id.clone(), "–".into(), "–".into(), (*why).to_owned()]);
            continue;
        }
        let pair = pair(id, acts_on)?;
        let (off_dn, before, frame_px) = frame(&pair.off, None).with_context(|| format!("the scene without {id}"))?;
        let (on_dn, after, _) = frame(&pair.on, pair.noise).with_context(|| format!("the scene with {id}"))?;
        let title = if is_second { format!("{id} (on pixels)") } else { id.clone() };
        let file = format!("{id}{}.png", if is_second { "-on-pixels" } else { "" });
        let shift_px = largest_shift_px(&before, &after);
        let moved = (shift_px > 0.0).then(|| format!("stars move by up to {shift_px:.1e} px"));
        let said: Vec<String> = [Some(pair.summary), moved].into_iter().flatten().filter(|text| !text.is_empty()).collect();
        let summary = said.join("; ");
        let picture = OffOn { title: title.clone(), summary: summary.clone(), frame_px, off_dn, on_dn };
        picture.write(&directory.join(&file))?;
        rows.push(vec![title.clone(), format!("{:.0}", picture.largest_dn()), format!("{shift_px:.1e}"), file.clone()]);
        let _ = writeln!(page, "<h2 id=\"{id}\">{title}</h2>\n<p>{summary}</p>\n<img src=\"{file}\" alt=\"{title}: off, on, difference\">");
    }
    bar.finish_and_clear();
    let head = "<!doctype html>\n<meta charset=\"utf-8\">\n<title>What every effect does to a frame</title>\n<h1>What every effect does to a frame</h1>\n\
        <p>Off, on, and the difference; below, the place where it is largest. Without noise but where noise is shown.</p>\n";
    write_file(&directory.join("index.html"), format!("{head}{page}").as_bytes())?;
    Ok(report::table(&["effect", "largest change (DN)", "largest shift (px)", "picture"], &rows))
}
