//! `boresight effects --pictures`: what every effect does to a frame, as pictures.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;

use anyhow::{Context, Result};
use boresight::catalog::Catalog;
use boresight::effects::ids;
use boresight::imaging::Backend;
use boresight::recording::write_file;
use boresight::render::{Renderer, TrueStar};
use boresight::report::{self, OffOn};
use boresight::scene::Scene;
use boresight::scene::effect_demo::{Known, SHOWN, View};

use super::output;

/// What the pictures see of the sky.
const VIEW: View = View { side_px: 256, focal_length_px: 700.0, faintest_magnitude: 8.0 };

/// A frame: its counts, its stars, its columns and rows.
type Taken = (Vec<f32>, Vec<TrueStar>, (usize, usize));

/// Takes the frame of a scene.
fn frame(text: &str, noise: Option<&str>) -> Result<Taken> {
    let mut scene = Scene::parse("the scene of the pictures", text)?;
    scene.pixel_effects.retain(|effect| match effect.id.as_str() {
        random @ (ids::PHOTON_NOISE | ids::READ_NOISE) => noise.is_some_and(|kept| kept == random),
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

/// Writes a picture of each effect, a page that holds them, and returns a table of them.
pub(crate) fn write(directory: &Path, effects: &[Known]) -> Result<String> {
    let bar = output::progress("pictures", effects.len());
    let (mut rows, mut page) = (Vec::new(), String::new());
    for effect in effects {
        bar.inc(1);
        // Some causes are both: a displacement for the calibrator, and what happens to the charge.
        let (id, is_second) = (&effect.id, effect.is_second());
        let Some(pair) = effect.pair(VIEW) else {
            rows.push(vec![id.clone(), "–".into(), "–".into(), effect.not_shown().unwrap_or_default().to_owned()]);
            continue;
        };
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
