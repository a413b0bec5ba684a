//! Frames of pixels: painted as they say, written as they are, and answered without their truths.

use boresight::blind::generate::{Concealed, Family, LIBRARY, PIXEL_LADDER, concealed};
use boresight::blind::{Answer, Centres, PixelAnswer, make, opened, painted, pixel_recording, run, score, write_pixels};
use boresight::catalog::Catalog;
use boresight::diagnose::DiagnoseOptions;
use boresight::recording::Recording;

const SEED: u64 = 3;

fn made(family: Family, index: u32) -> Concealed {
    concealed(family, index, SEED, Catalog::embedded())
}

/// The index of an effect at the top of the ladder.
fn strongest(label: &str) -> u32 {
    let effect = LIBRARY.iter().position(|kind| kind.label() == label).expect("an effect of the library");
    (effect + (PIXEL_LADDER.len() - 1) * LIBRARY.len()) as u32
}

/// A small fixed part of the tier: two nulls and two effects, in space and on the ground. While the answers are found there is no truth to be
/// opened.
#[test]
fn plain_cases_are_answered_from_pixels_without_their_truths() {
    let folder = tempfile::tempdir().unwrap();
    let [truth, away] = ["truth", "away"].map(|name| folder.path().join(name));
    let options = DiagnoseOptions { nulls: 100, ..DiagnoseOptions::default() };
    let cases = [
        (Family::PixelNull, 0..2),
        (Family::PixelLadder, strongest("quadratic-rest")..strongest("quadratic-rest") + 1),
        (Family::PixelLadder, strongest("thermal-focal-length")..strongest("thermal-focal-length") + 1),
    ];
    for (family, indices) in &cases {
        make(folder.path(), *family, indices.clone(), SEED, false).unwrap();
    }
    std::fs::rename(&truth, &away).unwrap();
    for (family, indices) in cases {
        assert_eq!(run(folder.path(), family, indices.clone(), &options, || ()).unwrap(), indices.len());
        assert_eq!(run(folder.path(), family, indices, &options, || ()).unwrap(), 0, "what is answered is not asked again");
    }
    std::fs::rename(&away, &truth).unwrap();
    let pairs = opened(folder.path()).unwrap();
    assert_eq!(pairs.len(), 4);
    for (truth, answer) in &pairs {
        let named = |answer: &Answer| answer.findings.iter().map(|finding| finding.id.clone()).collect::<Vec<_>>();
        let hidden: Vec<String> = truth.effects.iter().map(|effect| effect.id.clone()).collect();
        let pixels = answer.pixels.as_ref().unwrap_or_else(|| panic!("{} {}: {answer:?}", truth.family.name(), truth.index));
        println!("{} {} {}: {:?} {:.1} s", truth.family.name(), truth.index, truth.setup, named(answer), answer.seconds);
        assert_eq!(named(answer), hidden, "{} {}: {answer:?}", truth.family.name(), truth.index);
        assert_eq!(named(&pixels.lists), hidden, "{} {} as star lists", truth.family.name(), truth.index);
        assert_eq!(pixels.frames_identified, pixels.frames);
        assert!(pixels.stars_right * 20 > pixels.stars_painted * 19 && pixels.stars_wrong * 100 < pixels.stars_painted, "{pixels:?}");
        let Centres { count, square, .. } = pixels.centres;
        let scatter = (square / count as f64).sqrt();
        assert!((0.9..1.15).contains(&scatter), "centres scatter by {scatter} of their declared errors");
    }
    let score = score(&pairs);
    assert_eq!((score.answers, score.nulls.len()), (0, 0), "pixels are not counted among star lists");
    let pixels = score.pixels.expect("figures of pixels");
    assert_eq!((pixels.seen.answers, pixels.lists.answers, pixels.agreement.verdict.hits, pixels.agreement.first_name.hits), (4, 4, 4, 2));
    // The same sizes are hidden in both, so that what is found differs by the noise of both alone.
    let apart = &pixels.agreement.parameters;
    assert!(apart.count >= 3 && apart.sd < 3.0 && apart.mean.abs() < 2.0, "{apart:?}");
}

/// The same bytes again, in any number of threads; others for another recording.
#[test]
fn frames_are_the_same_again() {
    let canvas = made(Family::PixelNull, 0).canvas.unwrap();
    let frames = canvas.frames();
    let alone = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    assert!(alone.install(|| made(Family::PixelNull, 0).canvas.unwrap().frames()) == frames);
    assert!(frames[0] != frames[1]);
    assert!(made(Family::PixelNull, 2).canvas.unwrap().frames()[0] != frames[0]);
    assert!(frames.iter().all(|frame| frame.len() == canvas.size_px[0] * canvas.size_px[1]));
    assert!(made(Family::Null, 0).canvas.is_none());
}

/// What is diagnosed in memory is what the written folder holds, and the folder holds no list that names the stars.
#[test]
fn the_written_frames_are_those_in_memory() {
    let Concealed { lists, canvas, .. } = made(Family::PixelLadder, 3);
    let canvas = canvas.unwrap();
    let folder = tempfile::tempdir().unwrap();
    write_pixels(folder.path(), &lists, &canvas).unwrap();
    let read = Recording::open(&[folder.path()]).unwrap();
    let in_memory = pixel_recording(&lists, &canvas);
    assert_eq!((&read.camera, &read.site), (&in_memory.camera, &in_memory.site));
    assert_eq!(read.observations().unwrap(), in_memory.observations().unwrap());
    assert!(read.stars.is_none() && read.star_file.is_none());
    for (index, frame) in canvas.frames().iter().enumerate() {
        let loaded = read.load_frame(index).unwrap();
        assert!(loaded.pixels_dn.iter().zip(frame).all(|(a, b)| *a == f32::from(*b)), "frame {index}");
    }
}

/// Where no star is painted none is named, and the reason is told in the place of a verdict.
#[test]
fn a_dark_sky_is_not_diagnosed() {
    let Concealed { lists, canvas, .. } = made(Family::PixelNull, 0);
    let mut canvas = canvas.unwrap();
    canvas.stars.truncate(2);
    canvas.stars.iter_mut().for_each(Vec::clear);
    let lists = boresight::blind::generate::Lists { frames: lists.frames[..2].to_vec(), stars: Vec::new(), ..lists };
    let error = painted(&lists, &canvas, Catalog::embedded(), &DiagnoseOptions::default()).expect_err("no star, no diagnosis");
    assert!(error.to_string().contains("cannot be fitted"), "{error}");
}

/// Answers that contradict each other are counted as such.
#[test]
fn disagreement_is_counted() {
    let truth = made(Family::PixelNull, 0).truth;
    let plain = |verdict: &str, names: &[&str]| super::answer_of(Family::PixelNull, SEED, verdict, names);
    let both = |seen: Answer, lists: Answer| {
        let pixels = PixelAnswer {
            lists,
            frames_identified: 15,
            frames: 16,
            stars_painted: 100,
            stars_right: 90,
            stars_wrong: 10,
            centres: Centres { count: 2, sum: 2.0, square: 10.0, within_1: 1, beyond_4: 0 },
            seconds_by_step: [1.0, 2.0, 3.0, 4.0],
        };
        (truth.clone(), Answer { pixels: Some(Box::new(pixels)), ..seen })
    };
    let quiet = || plain("consistent", &[]);
    let pairs = [
        both(quiet(), quiet()),
        both(plain("explained", &["shear"]), quiet()),
        both(plain("explained", &["shear"]), plain("explained", &["spiral"])),
        both(quiet(), plain("unexplained", &[])),
    ];
    let figures = score(&pairs).pixels.expect("figures of pixels");
    let hits = |rate: boresight::blind::Rate| (rate.hits, rate.of);
    let agreement = &figures.agreement;
    assert_eq!(
        [agreement.verdict, agreement.detected, agreement.pixels_alone, agreement.lists_alone, agreement.first_name].map(hits),
        [(2, 4), (2, 4), (1, 4), (1, 4), (0, 2)]
    );
    let named = |score: &boresight::blind::Score| score.null_totals[0].as_ref().map(|null| hits(null.named));
    assert_eq!((named(&figures.seen), named(&figures.lists)), (Some((2, 4)), Some((1, 4))));
    let way = &figures.way;
    assert_eq!([way.frames, way.stars, way.wrong].map(hits), [(60, 64), (360, 400), (40, 400)]);
    assert!((way.centre_mean - 1.0).abs() < 1e-12 && (way.centre_sd - 2.0).abs() < 1e-12);
    let page = boresight::blind::markdown(&score(&pairs));
    assert!(
        page.contains("| same verdict | 50.0 % (2/4;") && page.contains("| a name in a null | 50.0 % (2/4; 15.0–85.0) | 25.0 % (1/4;"),
        "{page}"
    );
}
