//! What every registered effect adds to the CPU time of a frame: the scenes with and without it, in turns.

use std::fmt::Write as _;

use boresight::catalog::Catalog;
use boresight::imaging::Backend;
use boresight::render::Renderer;
use boresight::scene::Scene;
use boresight::scene::effect_demo::{Known, SHOWN, View, known};

use crate::{cpu_ms, median};

/// A frame of 1024² with about 2000 stars.
const VIEW: View = View { side_px: 1024, focal_length_px: 1300.0, faintest_magnitude: 7.7 };
/// Rounds of which the median is taken, after one that is not counted.
const ROUNDS: usize = 3;

/// What a scene may join, which is no effect but costs time as they do.
const JOINED: [(&str, &str); 3] = [
    ("[camera.binning] 2 × 2, charge", "binning = { factor = 2 }"),
    ("[camera.binning] 2 × 2, counts", "binning = { factor = 2, method = \"mean\", place = \"digital\" }"),
    ("[camera.binning] 4 × 4, charge", "binning = { factor = 4 }"),
];

/// A scene without and with something.
struct Case {
    name: String,
    off: Scene,
    on: Scene,
}

impl Case {
    fn new(effect: &Known) -> Result<Self, (String, String)> {
        let name = format!("{}{}", effect.id, if effect.is_second() { " (on pixels)" } else { "" });
        let Some(pair) = effect.pair(VIEW) else { return Err((name, effect.not_shown().unwrap_or_default().to_owned())) };
        let [mut off, on] = [&pair.off, &pair.on].map(|text| Scene::parse("the scene of the bench", text).unwrap());
        if let Some(noise) = pair.noise {
            off.pixel_effects.retain(|setting| setting.id.replace('_', "-") != noise);
        }
        Ok(Self { name, off, on })
    }

    /// CPU times without and with it, ms.
    fn times_ms(&self, backend: Backend) -> [f64; 2] {
        // The truth of what pixel effects do to stars is left out: it is not the frame.
        let renderer = |scene| Renderer::new(scene, Catalog::embedded(), backend).unwrap().with_pixel_shifts(false);
        let renderers = [&self.off, &self.on].map(renderer);
        let mut times = [Vec::new(), Vec::new()];
        for round in 0..=ROUNDS {
            for (renderer, times) in renderers.iter().zip(&mut times) {
                let begin = cpu_ms();
                std::hint::black_box(renderer.render(SHOWN).unwrap());
                if round > 0 {
                    times.push(cpu_ms() - begin);
                }
            }
        }
        times.map(median)
    }
}

/// The table, for effects whose names hold `only`.
pub(crate) fn effects(backends: &[(Backend, String)], only: &str, text: &mut String) {
    let (mut cases, mut not_shown) = (Vec::new(), Vec::new());
    for effect in known() {
        match Case::new(&effect) {
            Ok(case) => cases.push(case),
            Err(line) => not_shown.push(line),
        }
    }
    let plain = known().iter().find_map(|effect| effect.pair(VIEW)).unwrap().off;
    for (name, table) in JOINED {
        let parse = |text: &str| Scene::parse("the scene of the bench", text).unwrap();
        cases.push(Case {
            name: name.to_owned(),
            off: parse(&plain),
            on: parse(&plain.replacen("camera = {", &format!("camera = {{ {table},"), 1)),
        });
    }
    let stars = Renderer::new(&cases[0].off, Catalog::embedded(), Backend::Cpu).unwrap().render(SHOWN).unwrap().stars.len();
    let _ = writeln!(
        text,
        "\nCPU time of a frame of {0}² with {stars} stars without and with each effect, ms (and how many times as long); catalogue, projection and \
         truth of places are in it\n",
        VIEW.side_px
    );
    let _ = write!(text, "{:<40}", "");
    for (backend, _) in backends {
        let _ = write!(text, "  {:>26}", backend.to_string());
    }
    text.push('\n');
    for case in cases.iter().filter(|case| case.name.contains(only)) {
        let _ = write!(text, "{:<40}", case.name);
        for (backend, _) in backends {
            let [off, on] = case.times_ms(*backend);
            let _ = write!(text, "  {off:8.1} {on:8.1} {:>8}", format!("({:.2})", on / off));
        }
        text.push('\n');
    }
    for (name, why) in not_shown.iter().filter(|(name, _)| name.contains(only)) {
        let _ = writeln!(text, "{name:<40}  – {why}");
    }
}
