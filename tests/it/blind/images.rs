//! Frames with effects hidden in their pixels: painted as they say, written as they are, diagnosed without their truths, and scored.

use boresight::blind::generate::images::{IMAGE_KINDS, PixelKind, Reckoned};
use boresight::blind::generate::{Concealed, Family, IMAGE_TRAPS, PIXEL_LADDER, concealed};
use boresight::blind::{Answer, image_markdown, image_recording, image_score, make, opened, run, score, write_images};
use boresight::catalog::Catalog;
use boresight::diagnose::DiagnoseOptions;
use boresight::recording::Recording;

const SEED: u64 = 3;

fn made(family: Family, index: u32) -> Concealed {
    concealed(family, index, SEED, Catalog::embedded())
}

/// The index of an effect on a rung of the ladder.
fn on_the_ladder(label: &str, rung: usize) -> u32 {
    let effect = IMAGE_KINDS.iter().position(|kind| kind.label() == label).expect("an effect in pixels");
    (effect + rung * IMAGE_KINDS.len()) as u32
}

/// Every effect changes the counts of its frames, by nothing else than itself: without it the same random numbers give the plain frames.
#[test]
fn every_effect_changes_its_frames() {
    for kind in IMAGE_KINDS {
        let Concealed { images, truth, .. } = made(Family::ImageLadder, on_the_ladder(kind.label(), 2));
        let effect = &truth.effects[0];
        assert_eq!((effect.label.as_str(), effect.id.as_str()), (kind.label(), kind.id()));
        assert!(!effect.parameters.is_empty() && effect.parameters.iter().all(|own| own.value.is_finite()), "{effect:?}");
        // The frame that is another than the others, where there is one.
        let mut images = *images.unwrap();
        let of_one = matches!(kind, PixelKind::FrameDimmer | PixelKind::ExposureTime);
        let one = if of_one { images.hidden[0].numbers[0] as usize } else { 0 };
        images.world.frames.truncate(one + 1);
        let with = images.frames();
        images.hidden.clear();
        let without = images.frames();
        let changed = with[one].iter().zip(&without[one]).filter(|(a, b)| a != b).count();
        // Few tracks and streaks a frame leave some frames alone.
        assert!(changed >= usize::from(!matches!(kind, PixelKind::CosmicRays | PixelKind::Streaks)), "{}: nothing changes", kind.label());
        assert_eq!(with[one].len(), 512 * 512);
    }
}

/// What is reckoned by information has the signal asked for, unless more would be no camera's.
#[test]
fn sizes_are_multiples_of_what_is_just_seen() {
    for (kind, rung) in [(PixelKind::Vignetting, 0), (PixelKind::AmplifierStep, 1), (PixelKind::AxialColour, 1)] {
        let effect = made(Family::ImageLadder, on_the_ladder(kind.label(), rung)).truth.effects[0].clone();
        assert_eq!(kind.reckoned(), Reckoned::Stamps);
        assert!((effect.snr / (5.0 * PIXEL_LADDER[rung]) - 1.0).abs() < 0.06, "{}: {}", kind.label(), effect.snr);
    }
    assert_eq!(made(Family::ImageLadder, on_the_ladder("prnu", 3)).truth.effects[0].snr, 40.0);
}

/// The same bytes again, in any number of threads, and what is written is what is diagnosed in memory.
#[test]
fn frames_are_the_same_again_and_on_disk() {
    let Concealed { lists, images, canvas, .. } = made(Family::ImageNull, 0);
    assert!(canvas.is_none());
    let images = images.unwrap();
    let frames = images.frames();
    let alone = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    assert!(alone.install(|| made(Family::ImageNull, 0).images.unwrap().frames()) == frames);
    assert!(frames[0] != frames[1] && made(Family::ImageNull, 1).images.unwrap().frames()[0] != frames[0]);
    let folder = tempfile::tempdir().unwrap();
    write_images(folder.path(), &lists, &images).unwrap();
    let read = Recording::open(&[folder.path()]).unwrap();
    let in_memory = image_recording(&lists, &images);
    assert_eq!((&read.camera, &read.site), (&in_memory.camera, &in_memory.site));
    assert_eq!(read.observations().unwrap(), in_memory.observations().unwrap());
    for (index, frame) in frames.iter().enumerate() {
        let loaded = read.load_frame(index).unwrap();
        assert!(loaded.pixels_dn.iter().zip(frame).all(|(a, b)| *a == f32::from(*b)), "frame {index}");
    }
}

/// Each trap does to the frames what its name says.
#[test]
fn traps_are_what_they_are_called() {
    let of = |name: &str| {
        let place = IMAGE_TRAPS.iter().position(|trap| serde_json::to_value(trap).unwrap() == name).unwrap();
        made(Family::ImageHardNull, place as u32)
    };
    assert_eq!(of("few-frames").truth.frames, 4);
    let elongated = of("elongated-images").images.unwrap();
    let [a, b] = elongated.world.camera.profile.axes;
    assert!(a.hypot(b) > 0.14 && elongated.hidden.is_empty());
    assert!(of("winged-images").images.unwrap().world.camera.profile.core == 0.0);
    // No clouds are drawn where there is no air.
    let place = IMAGE_TRAPS.iter().position(|trap| serde_json::to_value(trap).unwrap() == "clouds").unwrap();
    for round in 0..4 {
        let truth = made(Family::ImageHardNull, (place + round * IMAGE_TRAPS.len()) as u32).truth;
        assert_eq!(truth.setup, "image-ground", "{}", truth.index);
    }
    let blended = of("blended-field").images.unwrap();
    let stars = || blended.world.frames.iter().flat_map(|frame| &frame.stars);
    let share = stars().filter(|star| !star.is_catalogued).count() as f64 / stars().filter(|star| star.is_catalogued).count() as f64;
    assert!((0.25..0.42).contains(&share), "{share}");
}

/// A recording in which pixels show something plainly, and one in which they do not; while they are answered there is no truth to be opened.
#[test]
fn plain_cases_are_answered_from_pixels() {
    let folder = tempfile::tempdir().unwrap();
    let [truth, away] = ["truth", "away"].map(|name| folder.path().join(name));
    let options = DiagnoseOptions { nulls: 50, ..DiagnoseOptions::default() };
    let strongest = PIXEL_LADDER.len() - 1;
    let cases = [(Family::ImageNull, 0), (Family::ImageLadder, on_the_ladder("banding, rows", strongest))];
    for (family, index) in cases {
        make(folder.path(), family, index..=index, SEED, false).unwrap();
    }
    std::fs::rename(&truth, &away).unwrap();
    for (family, index) in cases {
        assert_eq!(run(folder.path(), family, index..=index, &options, || ()).unwrap(), 1);
        assert_eq!(run(folder.path(), family, index..=index, &options, || ()).unwrap(), 0, "what is answered is not asked again");
    }
    std::fs::rename(&away, &truth).unwrap();
    let pairs = opened(folder.path()).unwrap();
    assert_eq!(pairs.len(), 2);
    for (truth, answer) in &pairs {
        let named: Vec<&str> = answer.findings.iter().map(|finding| finding.id.as_str()).collect();
        println!("{} {}: {named:?} {:?} {:.1} s", truth.family.name(), truth.index, answer.channels, answer.seconds);
        let hidden: Vec<&str> = truth.effects.iter().map(|effect| effect.id.as_str()).collect();
        assert!(answer.error.is_none() && hidden.iter().all(|id| named.contains(id)), "{answer:?}");
        assert!(answer.channels.contains_key("flux") && answer.channels.contains_key("noise"), "{:?}", answer.channels);
    }
    assert_eq!(score(&pairs).answers, 0, "what is hidden in pixels has figures of its own");
    assert_eq!(image_score(&pairs).answers, 2);
}

/// Right names, wrong names, withheld ones and silence are told apart.
#[test]
fn answers_are_counted() {
    let plain = |verdict: &str, names: &[&str], withheld: &[&str]| {
        let mut answer = super::answer_of(Family::ImageLadder, SEED, verdict, names);
        answer.withheld = withheld.iter().map(|id| ((*id).to_owned(), "a reason".to_owned())).collect();
        answer.effects = vec![("prnu".to_owned(), "not-found".to_owned())];
        answer
    };
    let truth = made(Family::ImageLadder, on_the_ladder("prnu", 1)).truth;
    let null = made(Family::ImageNull, 0).truth;
    let answers = [
        plain("explained", &["prnu"], &[]),
        plain("explained", &["shear", "prnu"], &[]),
        plain("consistent", &[], &["prnu"]),
        plain("consistent", &[], &[]),
        plain("unexplained", &[], &[]),
    ];
    let mut pairs: Vec<_> = answers.into_iter().map(|answer| (truth.clone(), answer)).collect();
    let mut alarm = plain("explained", &["vignetting"], &[]);
    alarm.family = Family::ImageNull;
    alarm.channels.insert("flux".to_owned(), "unexplained: field-radius".to_owned());
    pairs.push((null, alarm));
    let strong = |snr: f64, answer: Answer| {
        let mut truth = truth.clone();
        (truth.effects[0].multiple, truth.effects[0].snr) = (4.0, snr);
        (truth, answer)
    };
    let mut unjudged = plain("consistent", &[], &[]);
    unjudged.effects = vec![("prnu".to_owned(), "not-applicable".to_owned())];
    pairs.extend([
        strong(20.0, plain("explained", &["prnu"], &[])),
        strong(20.0, plain("explained", &["shear", "prnu"], &[])),
        strong(10.0, plain("consistent", &[], &[])),
        strong(20.0, unjudged),
    ]);
    let figures = image_score(&pairs);
    let pool = &figures.pool;
    let counted = [pool.first, pool.in_set, pool.first_of_cut, pool.first_of_unjudged].map(|rate| (rate.hits, rate.of));
    assert_eq!(counted, [(1, 2), (2, 2), (0, 1), (0, 1)]);
    let [ladder] = &figures.ladders[..] else { panic!("{figures:?}") };
    let rung = &ladder.rungs[0];
    assert_eq!((rung.of, rung.first, rung.in_set, rung.withheld, rung.silent, rung.detected), (5, 1, 2, 1, 1, 3));
    assert_eq!((rung.wrong["shear"], ladder.known, rung.multiple), (1, true, 2.0));
    // Two of the strong ones are named, with the signal-to-noise ratio of `answer_of` where 20 were hidden.
    assert_eq!((ladder.sized, ladder.snr_shares), (2, 2.0 * 9.0 / 20.0));
    let total = figures.nulls.last().unwrap();
    assert_eq!((total.counts.named.hits, total.names["vignetting"], total.unexplained["flux : field-radius"]), (1, 1, 1));
    let page = image_markdown(&figures, "abc1234");
    assert!(page.contains("| prnu | noise | 1 · 2 · 1 · 1 / 5 |") && page.contains("commit abc1234"), "{page}");
}
