//! Every stage of the registry of pixel effects and passes: its twins, its shader, its page, what it leaves alone.

use boresight::effects::pixel::pass::PassShape;
use boresight::effects::pixel::{AnyPixelEffect, ExposureContext, PIXEL_EFFECTS, POINT_SPREADS, Role, SeparableStar, Stage, Work};
use boresight::effects::{ParameterSpec, stem_of};
use boresight::imaging::{
    EffectSetting, FrameExposure, Imager, ImagingConfig, Output, PlacedStar, SplitLimits, chain_program, collect_program, compare_counts,
    pass_programs, uniforms_name,
};
use boresight::rng::StageKey;

use crate::house::root;
use crate::twins::{config, cpu, exposure, gpu, sky, typical};

/// A context as the twins' own tests have it.
fn context() -> ExposureContext {
    ExposureContext { width_px: 400, height_px: 301, star_light_e: 1e6, ..ExposureContext::default() }
}

/// Stars of 10 to 10⁷ electrons: light for every branch of every effect.
fn bright_and_faint(width: usize, height: usize) -> Vec<PlacedStar> {
    let mut stars = sky(300, width, height, 8);
    for star in stars.iter_mut().step_by(2) {
        star.electrons *= 0.1;
    }
    stars
}

/// The most that a pixel holds.
fn brightest_of(frame: &[f32]) -> f32 {
    frame.iter().fold(0.0, |most, value| most.max(value.abs()))
}

/// Pixels that differ by more than 1e-5 of themselves (of 1 electron, where they hold less) and 1e-7 of the brightest pixel of the frame, since
/// a pass brings the rounding of a bright pixel into faint ones. NaN is beyond everything.
pub(crate) fn far_apart(a: &[f32], b: &[f32]) -> usize {
    far_apart_beside(1e-7 * brightest_of(b), a, b)
}

/// The same where other electrons than the brightest pixel's were rounded.
fn far_apart_beside(rounding_e: f32, a: &[f32], b: &[f32]) -> usize {
    assert_eq!(a.len(), b.len());
    let far = |(a, b): (&f32, &f32)| a != b && ((a - b).is_nan() || (a - b).abs() > 1e-5 * b.abs().max(1.0) + rounding_e);
    a.iter().zip(b).filter(|(a, b)| far((a, b))).count()
}

/// The most that the pixels of a row or column hold together.
fn fullest_line(frame: &[f32], width: usize) -> f32 {
    let row = frame.chunks(width).map(|row| row.iter().sum::<f32>());
    let column = (0..width).map(|x| frame.iter().skip(x).step_by(width).sum::<f32>());
    row.chain(column).fold(0.0, f32::max)
}

/// The rounding that an effect may bring into any pixel, electrons: that of the brightest pixel. What carries charge along lines (blooming leaves
/// the excess of many pixels in one) brings that of a whole line, and all by which the light on it differs. `before` and `after`: by the twin;
/// `light`: before the effect, on the device.
fn rounding_e(effect: &dyn AnyPixelEffect, width: usize, [before, after, light]: [&[f32]; 3]) -> f32 {
    if !matches!(effect.work(), Work::Frame(PassShape::Lines(_), _)) {
        return 1e-7 * brightest_of(after);
    }
    let differences: Vec<f32> = before.iter().zip(light).map(|(a, b)| (a - b).abs()).collect();
    1e-7 * fullest_line(before, width) + fullest_line(&differences, width)
}

/// One effect at a time; what chance rounds may take another step where its input differs in the last bit.
#[test]
fn every_effect_agrees_with_its_twin() {
    for (width, height) in [(400, 301), (37, 23)] {
        let stars = bright_and_faint(width, height);
        for effect in PIXEL_EFFECTS {
            let config = config(width, height, vec![typical(*effect)]);
            let Some(gpu) = gpu("every_effect_agrees_with_its_twin", &config, SplitLimits::default()) else { return };
            let twin = cpu(&config);
            for frame_index in [0, u32::MAX] {
                let on_gpu = gpu.electrons_after(Some(Stage::Digital), &exposure(&stars, frame_index)).unwrap();
                let on_cpu = twin.electrons_after(Some(Stage::Digital), &exposure(&stars, frame_index)).unwrap();
                let before = twin.electrons_after(None, &exposure(&stars, frame_index)).unwrap();
                assert!(on_cpu != before || width < 100, "{} does nothing", effect.id());
                let steps = on_cpu.iter().all(|value| value.fract() == 0.0);
                let light = gpu.electrons_after(None, &exposure(&stars, frame_index)).unwrap();
                let rounding_e = rounding_e(*effect, width, [&before, &on_cpu, &light]);
                let far = far_apart_beside(rounding_e, &on_gpu, &on_cpu);
                assert!(on_gpu.iter().chain(&on_cpu).all(|value| value.is_finite()), "{}", effect.id());
                let most = if steps { (1e-4 * on_cpu.len() as f64).max(8.0) } else { 0.0 };
                let apart = on_gpu.iter().zip(&on_cpu).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
                let what = format!("{} at {width} × {height} px: by at most {apart} e, rounding {rounding_e} e", effect.id());
                println!("{what}");
                assert!(far as f64 <= most, "{what}: {far} pixels differ");
                // Where codes are missing the next step from the one below is the one above.
                let step = if effect.id() == "dnl" { 2.0 } else { 1.0 };
                assert!(on_gpu.iter().zip(&on_cpu).all(|(a, b)| (a - b).abs() <= step + 1e-5 * b.abs()), "{what}");
            }
        }
    }
}

/// Values other than the typical one: half as much again, and the ends of the range, for what a small frame shows in its extremes alone.
fn other_values(spec: &ParameterSpec) -> impl Iterator<Item = f64> {
    let (low, high) = spec.range;
    [(1.5 * spec.typical).clamp(low, high), high, low].into_iter().filter(|value| value.is_finite() && *value != spec.typical)
}

/// Parameters that change no pixel of these frames by themselves, and why.
const UNSEEN: &[(&str, &str, &str)] =
    &[("random-telegraph", "dwell_decades", "the state in the first frame hangs on the ratio of the dwell times alone")];

/// The negative control: of every stage every parameter that is another is seen, and so is one pixel that is twice as far away as the
/// tolerance allows.
#[test]
fn the_comparison_of_stages_can_fail() {
    let (width, height) = (120, 90);
    let stars = bright_and_faint(width, height);
    // Warmer than where parameters are measured: what doubles with the temperature is seen.
    let warm = FrameExposure { temperature_c: Some(33.0), ..exposure(&stars, 0) };
    let mut unseen = Vec::new();
    for effect in PIXEL_EFFECTS {
        let right = typical(*effect);
        let of = |setting: EffectSetting| cpu(&config(width, height, vec![setting])).electrons_after(Some(Stage::Digital), &warm).unwrap();
        let frame = of(right.clone());
        let mut spoilt = frame.clone();
        let brightest = brightest_of(&frame);
        spoilt[5] += 2.0 * (1e-5 * frame[5].abs().max(1.0) + 1e-7 * brightest);
        assert_eq!(far_apart(&spoilt, &frame), 1, "{}", effect.id());
        for (k, spec) in effect.parameters().iter().enumerate() {
            let is_seen = |value: f64| {
                let mut wrong = right.clone();
                wrong.parameters[k].1 = value;
                far_apart(&of(wrong), &frame) > 0
            };
            if !other_values(spec).any(is_seen) {
                unseen.push((effect.id(), spec.name));
            }
        }
    }
    let expected: Vec<(&str, &str)> = UNSEEN.iter().map(|(id, name, _)| (*id, *name)).collect();
    assert_eq!(unseen, expected, "parameters that change no pixel");
}

/// No pixel holds less than an effect says that it leaves at least; and enough effects say it that faint pixels can be ruled out.
#[test]
fn the_least_electrons_are_the_least() {
    let context = ExposureContext { width_px: 96, height_px: 64, star_light_e: 1e6, ..ExposureContext::default() };
    let mut sure = Vec::new();
    for effect in PIXEL_EFFECTS.iter().filter(|effect| effect.stage() == Stage::Light) {
        let Work::Pixels(apply) = effect.work() else { continue };
        let typical: Vec<f64> = effect.parameters().iter().map(|spec| spec.typical).collect();
        for (parameters, before_e) in [(&typical, 50.0), (&typical, 3000.0), (&effect.identity().unwrap_or_default(), 50.0)] {
            let mut pixels = vec![before_e as f32; 96 * 64];
            let key = StageKey { seed: 5, frame: 0, stage: effect.rng_stage() };
            apply(&effect.uniforms(parameters, &context), key, 0, &mut pixels);
            let least_e = pixels.into_iter().fold(f32::INFINITY, f32::min);
            let said_e = effect.least_e(parameters, &context, before_e);
            assert!(f64::from(least_e) >= said_e * (1.0 - 1e-6), "{}: {least_e} electrons, but {said_e} were said", effect.id());
            sure.extend((said_e > 0.0).then_some(effect.id()));
        }
    }
    assert!(["background", "vignetting", "dark-current"].iter().all(|id| sure.contains(id)), "{sure:?}");
}

/// Where no pixel can be faint, the program without their way gives the bytes of the program with it.
#[test]
fn a_frame_without_faint_pixels_is_the_same() {
    let (width, height) = (96, 70);
    let effects = ["background", "vignetting", "photon_noise", "read_noise", "adc"];
    let effects = effects.map(|id| typical(boresight::effects::pixel::pixel_effect(id).expect("it is registered"))).to_vec();
    let Some(imager) = gpu("a_frame_without_faint_pixels_is_the_same", &config(width, height, effects), SplitLimits::default()) else {
        return;
    };
    let stars = sky(60, width, height, 3);
    let bright = imager.expose(&exposure(&stars, 4)).unwrap().pixels_dn;
    // Less than nothing in a single pixel of the sky, where no star is, makes that pixel faint and the program another.
    let mut sky_e = vec![0.0; width * height];
    sky_e[0] = -60.0;
    let faint = imager.expose(&FrameExposure { sky_e: &sky_e, ..exposure(&stars, 4) }).unwrap().pixels_dn;
    let differ: Vec<usize> = (0..bright.len()).filter(|i| bright[*i] != faint[*i]).collect();
    assert_eq!(differ, [0]);
}

/// A pass gives the same bytes where the frame lies in several buffers, where lines are walked in parts, and on any number of threads.
#[test]
fn passes_do_not_depend_on_how_they_are_split() {
    let (width, height) = (61, 83);
    let stars = bright_and_faint(width, height);
    let test = "passes_do_not_depend_on_how_they_are_split";
    for effect in PIXEL_EFFECTS.iter().filter(|effect| matches!(effect.work(), Work::Frame(..))) {
        let config = config(width, height, vec![typical(*effect)]);
        let frame = |imager: &Imager| imager.electrons_after(Some(Stage::Digital), &exposure(&stars, 1)).unwrap();
        let in_pool = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| frame(&cpu(&config)))
        };
        assert_eq!(in_pool(1), in_pool(2), "{}", effect.id());
        let Some(whole) = gpu(test, &config, SplitLimits::default()) else { continue };
        let expected = frame(&whole);
        for (entries_per_dispatch, buffer_bytes) in [(7, 128 << 20), (60_000, 61 * 4 * 16), (13, 61 * 4 * 40)] {
            let split = gpu(test, &config, SplitLimits { entries_per_dispatch, buffer_bytes }).expect("there was an adapter before");
            assert_eq!(frame(&split), expected, "{} in parts of {entries_per_dispatch} and {buffer_bytes} bytes", effect.id());
            assert_eq!(frame(&split), expected, "{} a second time", effect.id());
        }
    }
}

/// All stages but those left out.
fn everything_but(left_out: &[&str], width: usize, height: usize) -> ImagingConfig {
    let effects = PIXEL_EFFECTS.iter().filter(|effect| !left_out.contains(&effect.id()));
    config(width, height, effects.map(|effect| typical(*effect)).collect())
}

/// All stages at once: the same counts on both sides but for steps of chance, the same bytes at any number of threads, each frame by itself.
#[test]
fn the_whole_chain_is_reproducible_and_agrees() {
    let (width, height) = (251, 187);
    let config = everything_but(&[], width, height);
    let stars = bright_and_faint(width, height);
    let in_pool = |threads: usize, frame_index: u32| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| cpu(&config).expose(&exposure(&stars, frame_index)).unwrap())
    };
    let alone = [in_pool(1, 0), in_pool(1, 1)];
    assert_ne!(alone[0], alone[1]);
    let imager = cpu(&config);
    for frame in [1, 0, 1] {
        assert_eq!(in_pool(2, frame), alone[frame as usize], "two threads, frame {frame}");
        assert_eq!(imager.expose(&exposure(&stars, frame)).unwrap(), alone[frame as usize], "in a series, frame {frame}");
    }
    // A frequency that is rounded the other way changes the 64 pixels of its block.
    for (left_out, most) in [(&["jpeg"][..], 2e-4), (&[][..], 1e-2)] {
        let config = everything_but(left_out, width, height);
        let Some(gpu) = gpu("the_whole_chain_is_reproducible_and_agrees", &config, SplitLimits::default()) else { return };
        let (on_gpu, on_cpu) = (gpu.expose(&exposure(&stars, 1)).unwrap(), cpu(&config).expose(&exposure(&stars, 1)).unwrap());
        let (differing, largest) = compare_counts(&on_gpu.pixels_dn, &on_cpu.pixels_dn);
        println!("{width} × {height} px without {left_out:?}: {differing} differ, by at most {largest} DN");
        assert!(differing as f64 <= most * (width * height) as f64, "{differing} pixels differ, by up to {largest} DN");
    }
}

#[test]
fn switched_to_nothing_an_effect_changes_nothing() {
    let (width, height) = (90, 70);
    let stars = sky(30, width, height, 9);
    let without = cpu(&config(width, height, vec![])).electrons_after(Some(Stage::Digital), &exposure(&stars, 0)).unwrap();
    let mut tried = 0;
    for effect in PIXEL_EFFECTS {
        let Some(values) = effect.identity() else { continue };
        let parameters: Vec<_> = effect.parameters().iter().map(|spec| spec.name).zip(values).collect();
        let config = config(width, height, vec![EffectSetting::new(effect.id(), &parameters)]);
        let with = cpu(&config).electrons_after(Some(Stage::Digital), &exposure(&stars, 0)).unwrap();
        assert_eq!(with, without, "{} on the CPU", effect.id());
        if let Some(gpu) = gpu("switched_to_nothing_an_effect_changes_nothing", &config, SplitLimits::default()) {
            let on_gpu = gpu.electrons_after(Some(Stage::Digital), &exposure(&stars, 0)).unwrap();
            assert_eq!(on_gpu, gpu.electrons_after(None, &exposure(&stars, 0)).unwrap(), "{} on the GPU", effect.id());
        }
        tried += 1;
    }
    assert!(tried >= 2);
}

/// What truth without noise builds on: chance changes from frame to frame and nothing else does, what only adds takes no part of the light, and
/// the effects on light are a factor and a summand in every pixel.
#[test]
fn effects_do_what_their_role_says() {
    let (width, height) = (64_u32, 48_u32);
    let exposure = ExposureContext { width_px: 64, height_px: 48, star_light_e: 1e5, ..ExposureContext::default() };
    for effect in PIXEL_EFFECTS {
        let Work::Pixels(apply) = effect.work() else {
            assert!(effect.stage() > Stage::Light && effect.role() != Role::Adds, "{}: light is not moved between pixels", effect.id());
            continue;
        };
        let values: Vec<f64> = effect.parameters().iter().map(|spec| spec.typical).collect();
        let uniforms = effect.uniforms(&values, &exposure);
        let of = |level: f32, frame: u32| {
            let mut pixels = vec![level; (width * height) as usize];
            apply(&uniforms, StageKey { seed: 5, frame, stage: effect.rng_stage() }, 0, &mut pixels);
            pixels
        };
        let frames = [of(500.0, 0), of(500.0, 1)];
        // Some hot pixels are there in half of the frames, and some pixels switch from frame to frame.
        let blinks = ["hot-pixels", "random-telegraph"].contains(&effect.id());
        assert!(blinks || (effect.role() == Role::Noise) == (frames[0] != frames[1]), "{}: chance from frame to frame", effect.id());
        if effect.role() == Role::Noise || effect.stage() != Stage::Light {
            continue;
        }
        // Stray light that falls over the frame ends at nothing, so there is some light everywhere.
        let [none, some, more] = [1024.0, 2048.0, 5120.0].map(|level| of(level, 0));
        for i in 0..none.len() {
            let (first, second) = (some[i] - none[i], more[i] - none[i]);
            assert!((second - 4.0 * first).abs() <= 1e-3, "{}: light adds up: {first}, {second}", effect.id());
            assert!(effect.role() != Role::Adds || (first - 1024.0).abs() <= 1e-3, "{} takes of the light", effect.id());
        }
    }
}

/// What says that it moves charge without loss does: a star in the middle of a dark frame, from which nothing reaches an edge.
#[test]
fn charge_is_conserved_where_it_is_said() {
    let (width, height) = (200, 420);
    let stars = [PlacedStar { x_px: 60.3, y_px: 90.7, electrons: 2e6, sigma_px: 1.5 }];
    let total = |frame: &[f32]| frame.iter().map(|value| f64::from(*value)).sum::<f64>();
    let mut tried = 0;
    for effect in PIXEL_EFFECTS.iter().filter(|effect| effect.conserves_charge()) {
        let imager = cpu(&config(width, height, vec![typical(*effect)]));
        let before = imager.electrons_after(None, &exposure(&stars, 0)).unwrap();
        let after = imager.electrons_after(Some(Stage::Digital), &exposure(&stars, 0)).unwrap();
        let moved: f64 = before.iter().zip(&after).map(|(a, b)| f64::from((a - b).abs())).sum();
        assert!(moved > 100.0, "{} moves {moved} electrons", effect.id());
        assert!((total(&after) / total(&before) - 1.0).abs() < 2e-6, "{}: {} of {}", effect.id(), total(&after), total(&before));
        tried += 1;
    }
    assert!(tried >= 2);
}

pub(crate) fn parse(program: &str) -> naga::Module {
    let module = naga::front::wgsl::parse_str(program).unwrap_or_else(|error| panic!("{}", error.emit_to_string(program)));
    naga::valid::Validator::new(naga::valid::ValidationFlags::all(), naga::valid::Capabilities::empty())
        .validate(&module)
        .unwrap_or_else(|error| panic!("{}", error.emit_to_string(program)));
    module
}

/// Names and offsets of a struct's members, and its size.
pub(crate) fn members(module: &naga::Module, name: &str) -> (Vec<(String, usize)>, usize) {
    let (_, ty) = module.types.iter().find(|(_, ty)| ty.name.as_deref() == Some(name)).unwrap_or_else(|| panic!("no struct {name}"));
    let naga::TypeInner::Struct { members, span } = &ty.inner else { panic!("{name} is no struct") };
    let members = members.iter().map(|member| (member.name.clone().unwrap_or_default(), member.offset as usize)).collect();
    (members, *span as usize)
}

/// Whether the uniforms of all these effects lie in the module where their twins have them.
fn check_uniforms(module: &naga::Module, effects: &[&dyn AnyPixelEffect]) {
    let mut offset = 0;
    let mut expected = Vec::new();
    for effect in effects.iter().filter(|effect| !effect.fields().is_empty()) {
        let (fields, span) = members(module, &uniforms_name(&effect.stem()));
        let rust: Vec<_> = effect.fields().iter().map(|(name, offset)| ((*name).to_owned(), *offset)).collect();
        assert_eq!(fields, rust, "{}", effect.id());
        let parameters: Vec<_> = effect.parameters().iter().map(|spec| spec.typical).collect();
        let bytes = effect.uniforms(&parameters, &context());
        assert_eq!(bytes.len(), span, "{}", effect.id());
        expected.push((effect.stem(), offset));
        offset += bytes.len().next_multiple_of(16);
    }
    if !expected.is_empty() {
        assert_eq!(members(module, "Effects").0, expected);
    }
}

/// Every effect alone, with its neighbour in the list, and all of them make programs that WGSL's own rules accept, with every uniform where the
/// twin's struct has it; and so does every sweep of every pass, in one buffer and in several.
#[test]
fn shaders_are_sound_and_their_uniforms_lie_where_the_twins_have_them() {
    for spread in POINT_SPREADS {
        for (width_px, goes_on) in [(64, false), (64, true), (68, true), (67, true)] {
            let module = parse(&collect_program(*spread, width_px, goes_on));
            assert_eq!(members(&module, "Star").1, size_of::<SeparableStar>());
        }
    }
    let on_pixels: Vec<_> = PIXEL_EFFECTS.iter().copied().filter(|effect| matches!(effect.work(), Work::Pixels(_))).collect();
    let subsets = (0..=on_pixels.len()).flat_map(|first| (1..=2).map(move |count| (first, count)));
    let subsets = subsets.filter_map(|(first, count)| on_pixels.get(first..first + count)).chain([&[][..], &on_pixels[..]]);
    for effects in subsets {
        for (output, may_be_faint) in [(Output::Counts, true), (Output::Electrons, true), (Output::Counts, false)] {
            check_uniforms(&parse(&chain_program(effects, may_be_faint, output)), effects);
        }
    }
    for effect in PIXEL_EFFECTS {
        let Work::Frame(shape, _) = effect.work() else { continue };
        let sweeps = match shape {
            PassShape::Lines(sweeps) => sweeps.len(),
            PassShape::Neighbours { sweeps } => sweeps,
        };
        for in_bands in [false, true] {
            let programs = pass_programs(*effect, shape, in_bands);
            assert_eq!(programs.len(), sweeps);
            for program in programs {
                let module = parse(&program.wgsl);
                check_uniforms(&module, &[*effect]);
                assert!(module.entry_points.iter().any(|entry| entry.name == program.entry));
            }
        }
    }
}

/// The keys of random numbers that were given by hand.
const RNG_STAGES: [(&str, u32); 8] = [
    ("photon-noise", 1),
    ("read-noise", 2),
    ("prnu", 3),
    ("dark-current", 4),
    ("hot-pixels", 5),
    ("banding", 6),
    ("dnl", 7),
    ("random-telegraph", 8),
];

/// Ids, random stages, files and pages of everything in the registries.
#[test]
fn every_pixel_effect_has_its_file_its_shader_and_its_page() {
    let (mut ids, mut stages) = (Vec::new(), Vec::new());
    let mut order = Stage::Light;
    let pages = PIXEL_EFFECTS.iter().map(|effect| (effect.id(), effect.source(), effect.wgsl(), effect.parameters()));
    let spreads = POINT_SPREADS.iter().map(|spread| (spread.id(), spread.source(), spread.wgsl(), spread.parameters()));
    for (id, source, wgsl, parameters) in pages.chain(spreads) {
        assert!(!ids.contains(&id), "{id} stands twice in the registries");
        ids.push(id);
        let id = stem_of(id);
        let folders = ["sky", "optics", "motion", "detector"].map(|folder| root().join(format!("src/effects/{folder}/{id}.rs")));
        let file = folders.iter().find(|path| path.is_file()).unwrap_or_else(|| panic!("{id} has no file of its name"));
        let code = std::fs::read_to_string(file).unwrap();
        assert!(code.starts_with(source) && source.starts_with("//!"), "{id} shows the page of another");
        assert_eq!(std::fs::read_to_string(root().join(format!("shaders/{id}.wgsl"))).unwrap(), wgsl, "{id} runs the shader of another");
        let in_shader = wgsl.contains(&format!("fn {id}(")) || wgsl.contains(&format!("fn {id}_quad("));
        assert!(in_shader && code.contains(&format!("fn {id}(")), "the twins of {id} have other names");
        let page = boresight::effects::page_of(source);
        crate::common::check_page(&id, &page);
        for parameter in parameters {
            assert!(page.contains(&format!("`{}`", parameter.name)), "the page of {id} is silent about {}", parameter.name);
            assert!((parameter.range.0..=parameter.range.1).contains(&parameter.typical), "{id}: {}", parameter.name);
        }
    }
    for effect in PIXEL_EFFECTS {
        assert!(effect.stage() >= order, "{} stands after a later stage", effect.id());
        order = effect.stage();
        if effect.rng_stage() != 0 {
            assert!(!stages.contains(&effect.rng_stage()), "{} draws another effect's random numbers", effect.id());
            stages.push(effect.rng_stage());
            // Below 2³¹ the numbers are those with which frames were made before they followed from the id: they never change.
            let pinned = RNG_STAGES.iter().find(|(id, _)| *id == effect.id()).map(|(_, stage)| *stage);
            assert!(pinned.map_or(effect.rng_stage() >= 1 << 31, |stage| stage == effect.rng_stage()), "{}: another key", effect.id());
        }
        let nothing = effect.identity();
        assert!(nothing.is_none_or(|values| {
            values.len() == effect.parameters().len()
                && values.iter().zip(effect.parameters()).all(|(value, spec)| (spec.range.0..=spec.range.1).contains(value))
        }));
    }
}
