//! Pixel statistics against frames drawn by the textbook's equations, with a generator of their own.

use super::*;

/// Numbers by chance: xorshift* and Box–Muller.
struct Chance(u64);

impl Chance {
    fn uniform(&mut self) -> f64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        (self.0.wrapping_mul(0x2545_F491_4F6C_DD1D) >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn normal(&mut self) -> f64 {
        (-2.0 * (1.0 - self.uniform()).ln()).sqrt() * (std::f64::consts::TAU * self.uniform()).cos()
    }
}

/// A camera, and what is wrong with it.
#[derive(Clone)]
struct Camera {
    side: usize,
    gain: f64,
    bias: f64,
    read_noise: f64,
    row_sigma: f64,
    prnu: f64,
    dsnu: f64,
    parity: f64,
    hot: usize,
    jumping: usize,
    rays: usize,
}

impl Default for Camera {
    fn default() -> Self {
        Self {
            side: 256,
            gain: 0.5,
            bias: 100.0,
            read_noise: 4.0,
            row_sigma: 0.0,
            prnu: 0.0,
            dsnu: 0.0,
            parity: 0.0,
            hot: 0,
            jumping: 0,
            rays: 0,
        }
    }
}

/// Sky of frames, electrons.
fn frames(camera: &Camera, skies: &[f64], seed: u64) -> Vec<(Frame, Vec<StarDisc>)> {
    let mut chance = Chance(0x9E37_79B9_7F4A_7C15 ^ seed.wrapping_mul(0xD134_2543_DE82_EF95) | 1);
    let pixels = camera.side * camera.side;
    let response: Vec<f64> = (0..pixels).map(|_| 1.0 + camera.prnu * chance.normal()).collect();
    let dark: Vec<f64> = (0..pixels).map(|_| camera.dsnu * chance.normal()).collect();
    let pick =
        |count: usize, chance: &mut Chance| -> Vec<usize> { (0..count).map(|_| (chance.uniform() * pixels as f64) as usize).collect() };
    let hot = pick(camera.hot, &mut chance);
    let jumping = pick(camera.jumping, &mut chance);
    let draw = |(_, sky): (usize, &f64)| {
        let rows: Vec<f64> = (0..camera.side).map(|_| camera.row_sigma * chance.normal()).collect();
        let mut electrons: Vec<f64> = (0..pixels)
            .map(|index| {
                let (x, y) = (index % camera.side, index / camera.side);
                // brighter at the right, by a third
                let light = sky * (0.85 + 0.3 * x as f64 / camera.side as f64) * response[index];
                let parity = if x % 2 == 0 { camera.parity } else { -camera.parity };
                light + light.sqrt() * chance.normal() + dark[index] + parity + rows[y] + camera.read_noise * chance.normal()
            })
            .collect();
        for index in &hot {
            electrons[*index] += 25.0 * sky.sqrt();
        }
        for index in &jumping {
            electrons[*index] += if chance.uniform() < 0.4 { 12.0 * sky.sqrt() } else { 0.0 };
        }
        for index in pick(camera.rays, &mut chance) {
            electrons[index] += 40.0 * sky.sqrt();
        }
        let pixels_dn = electrons.iter().map(|e| (e / camera.gain + camera.bias).round() as f32).collect();
        let stars: Vec<StarDisc> = (0..20)
            .map(|_| StarDisc { x_px: chance.uniform() * camera.side as f64, y_px: chance.uniform() * camera.side as f64, radius_px: 6.0 })
            .collect();
        (Frame { width_px: camera.side, height_px: camera.side, pixels_dn, saturation_dn: 65_535.0 }, stars)
    };
    skies.iter().enumerate().map(draw).collect()
}

fn statistics(camera: &Camera, skies: &[f64], seed: u64) -> PixelStatistics {
    statistics_of(camera, &frames(camera, skies, seed), |_| Some(1.0))
}

fn statistics_of(camera: &Camera, frames: &[(Frame, Vec<StarDisc>)], exposure_s: impl Fn(usize) -> Option<f64>) -> PixelStatistics {
    statistics_as_read(camera, frames, exposure_s, Frame::lowest_dn)
}

fn statistics_as_read(
    camera: &Camera,
    frames: &[(Frame, Vec<StarDisc>)],
    exposure_s: impl Fn(usize) -> Option<f64>,
    lowest_dn: impl Fn(&Frame) -> f32,
) -> PixelStatistics {
    let of = |(number, (frame, stars)): (usize, &(Frame, Vec<StarDisc>))| {
        let (lowest_read_dn, exposure_s) = (lowest_dn(frame), exposure_s(number));
        FrameStatistics::of(&SkyFrame { number, lowest_read_dn, frame, stars, bad: None, exposure_s, is_compared: true })
    };
    let all = frames.iter().enumerate().filter_map(of).collect();
    let mut counts = CountStatistics::new(1.0);
    for (frame, _) in frames {
        counts.add(frame, None);
    }
    PixelStatistics::of(
        all,
        Some(counts),
        &KnownCamera { bias_dn: Some(camera.bias), gain_e_per_dn: Some(camera.gain), narrowest_star_px: Some(1.0) },
    )
}

const SKIES: [f64; 8] = [300.0, 340.0, 420.0, 500.0, 560.0, 640.0, 700.0, 800.0];

#[test]
fn without_anything_wrong_nothing_shows() {
    let mut deviations: Vec<(&str, Vec<f64>)> = Vec::new();
    let mut note = |name: &'static str, value: f64| match deviations.iter_mut().find(|(known, _)| *known == name) {
        Some((_, all)) => all.push(value),
        None => deviations.push((name, vec![value])),
    };
    for seed in 0..16 {
        let found = statistics(&Camera::default(), &SKIES, seed);
        let transfer = found.photon_transfer.unwrap();
        note("gain", (transfer.slope_dn - 2.0) / transfer.slope_sigma_dn);
        let expected = 16.0 / 0.25 - 100.0 * 2.0 + 1.0 / 12.0;
        note("intercept", (transfer.intercept_dn2 - expected) / transfer.intercept_sigma_dn2);
        note("curvature", transfer.curvature / transfer.curvature_sigma);
        let (read_noise, sigma) = transfer.read_noise_e(100.0).unwrap();
        note("read noise", (read_noise - 4.0) / sigma);
        let (bias, sigma) = transfer.bias_dn(4.0).unwrap();
        note("bias", (bias - 100.0) / sigma);
        let lines = &found.lines;
        for (name, estimate) in [
            ("rows", lines.row_variance_dn2),
            ("columns", lines.column_variance_dn2),
            ("column parity", lines.column_parity_dn),
            ("row parity", lines.row_parity_dn),
            ("diagonal parity", lines.diagonal_parity_dn),
            ("step", lines.middle_step_dn),
            ("row persistence", lines.row_persistence),
            ("share", found.fixed_pattern.share),
            ("by light", found.fixed_pattern.by_light),
            ("by exposure", found.fixed_pattern.by_exposure),
        ] {
            note(name, estimate.unwrap().deviation());
        }
        for (name, estimate) in
            ["column", "row", "diagonal", "antidiagonal", "two columns", "two rows"].iter().zip(found.neighbours.unwrap().all())
        {
            note(name, estimate.deviation());
        }
        assert_eq!((found.fixed_pattern.hot, found.fixed_pattern.dead, found.fixed_pattern.jumping), (0, 0, Some(0)));
        assert_eq!(found.cosmic_rays.unwrap().count, 0);
    }
    for (name, all) in deviations {
        let n = all.len() as f64;
        let mean = all.iter().sum::<f64>() / n;
        let sd = (all.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt();
        println!("{name:20} mean {mean:6.2} sd {sd:5.2}");
        assert!(mean.abs() < 0.9, "{name}: mean deviation {mean}");
        assert!((0.5..1.6).contains(&sd), "{name}: scatter of deviations {sd}");
    }
}

#[test]
fn what_is_there_is_measured() {
    let pulls = |name: &str, truth: f64, find: &dyn Fn(u64) -> Estimate| {
        let found: Vec<Estimate> = (100..105).map(find).collect();
        let mean = found.iter().map(|one| one.value).sum::<f64>() / found.len() as f64;
        println!("{name}: {mean} for {truth}, lowest deviation {}", found.iter().map(Estimate::deviation).fold(f64::INFINITY, f64::min));
        assert!((mean / truth - 1.0).abs() < 0.1, "{name}: {mean} for {truth}");
        assert!(found.iter().all(|one| one.deviation() > 4.0), "{name}");
    };
    let lines = |camera: Camera| move |seed: u64| statistics(&camera, &SKIES, seed).lines;
    let banded = lines(Camera { row_sigma: 2.0, ..Camera::default() });
    pulls("rows", 16.0, &|seed| banded(seed).row_variance_dn2.unwrap());
    let odd = lines(Camera { parity: 0.5, ..Camera::default() });
    pulls("parity", 1.0, &|seed| {
        let found = odd(seed).column_parity_dn.unwrap();
        Estimate { value: -found.value, ..found }
    });
    let unequal = Camera { prnu: 0.01, ..Camera::default() };
    pulls("prnu", 1e-4, &|seed| statistics(&unequal, &SKIES, seed).fixed_pattern.by_light.unwrap());
    let dark = Camera { dsnu: 5.0, ..Camera::default() };
    pulls("dsnu", 100.0, &|seed| statistics(&dark, &SKIES, seed).fixed_pattern.by_exposure.unwrap());
    // each is not taken for the other
    let other = statistics(&dark, &SKIES, 7).fixed_pattern.by_light.unwrap();
    assert!(other.deviation() < 4.0, "{other:?}");
}

/// Of halves whose gains differ the pattern is that of the mean of both, whichever the median noise is of.
#[test]
fn a_pattern_is_that_of_all_the_frame() {
    const MORE: f32 = 1.2;
    let dark = Camera { dsnu: 5.0, ..Camera::default() };
    for below in [100, 156] {
        let mut all = frames(&dark, &SKIES, 11);
        for (frame, _) in &mut all {
            let (bias, lower) = (dark.bias as f32, below * frame.width_px);
            frame.pixels_dn[lower..].iter_mut().for_each(|value| *value = (bias + MORE * (*value - bias)).round());
        }
        let found = statistics_of(&dark, &all, |_| Some(1.0)).fixed_pattern.by_exposure.unwrap();
        let share = below as f64 / 256.0;
        let expected = 100.0 * (share + (1.0 - share) * f64::from(MORE * MORE));
        assert!((found.value / expected - 1.0).abs() < 0.07, "{found:?} for {expected}");
    }
}

#[test]
fn defects_and_rays_are_counted() {
    let camera = Camera { hot: 30, jumping: 30, rays: 5, ..Camera::default() };
    let skies: Vec<f64> = SKIES.iter().chain(&SKIES).copied().collect();
    let found = statistics(&camera, &skies, 3);
    let pattern = &found.fixed_pattern;
    let rays = found.cosmic_rays.unwrap();
    println!("{} hot, {} dead, {:?} jumping, {rays:?}", pattern.hot, pattern.dead, pattern.jumping);
    assert_eq!(pattern.hot, 30, "{pattern:?}");
    assert!((28..=30).contains(&pattern.jumping.unwrap()), "{pattern:?}");
    assert!((75..=80).contains(&rays.count), "{rays:?}");
}

#[test]
fn frames_are_kept_evenly() {
    for (frames, pixels) in [(10, 1 << 20), (40, 1 << 20), (1000, 1 << 18), (100_000, 1 << 20), (50, 1 << 26)] {
        let kept: Vec<usize> = (0..frames).filter(|number| is_compared(*number, frames, pixels)).collect();
        let most = (MAX_PATTERN_BYTES / pixels).min(MAX_PATTERN_FRAMES).min(frames);
        assert_eq!(kept.len(), most, "{frames} frames of {pixels} pixels");
    }
}

/// The frames of a camera without anything wrong, with what `change` makes of a pixel (column, row) and its count.
fn changed(seed: u64, change: impl Fn([usize; 2], f32) -> f32) -> Vec<(Frame, Vec<StarDisc>)> {
    let mut all = frames(&Camera::default(), &SKIES, seed);
    for (frame, _) in &mut all {
        let width = frame.width_px;
        frame.pixels_dn.iter_mut().enumerate().for_each(|(index, value)| *value = change([index % width, index / width], *value));
    }
    all
}

/// A border that stacking leaves, or pixels that are cut at one count, have no noise to measure by.
#[test]
fn a_border_of_one_value_is_no_sky() {
    let bordered = changed(1, |[_, y], value| if y < 32 { 0.0 } else { value });
    let found = statistics_of(&Camera::default(), &bordered, |_| Some(1.0)).fixed_pattern;
    assert_eq!((found.hot, found.dead, found.jumping), (0, 0, Some(0)), "{found:?}");
    assert!(found.pixels <= 256 * 224 && found.share.unwrap().deviation().abs() < 4.0, "{found:?}");
}

/// Colours have levels of their own: neither pixels that are hot, dead or unequal, nor banding, nor blocks, nor a noise that is too large.
#[test]
fn a_mosaic_of_colours_is_no_pattern() {
    const COLOURS: [f32; 4] = [0.6, 1.0, 1.0, 0.5];
    let mosaic = changed(2, |[x, y], value| (100.0 + COLOURS[x % 2 + 2 * (y % 2)] * (value - 100.0)).round());
    let found = statistics_of(&Camera::default(), &mosaic, |_| Some(1.0));
    let pattern = &found.fixed_pattern;
    assert_eq!((pattern.hot, pattern.dead, pattern.jumping), (0, 0, Some(0)), "{pattern:?}");
    assert!(pattern.share.unwrap().deviation().abs() < 4.0, "{pattern:?}");
    let lines = &found.lines;
    for (name, own) in [("rows", lines.row_variance_dn2), ("columns", lines.column_variance_dn2)] {
        assert!(own.unwrap().deviation().abs() < 4.0, "{name}: {own:?}");
    }
    // What the colours differ by is measured still: of the light, in counts, of frames that count by the inverse of their variance.
    let light_dn = 2.0 * SKIES.len() as f64 / SKIES.iter().map(|sky| sky.recip()).sum::<f64>();
    let diagonal = lines.diagonal_parity_dn.unwrap();
    assert!((diagonal.value / light_dn + 0.225).abs() < 0.02, "{diagonal:?} of {light_dn}");
    assert!(found.compression.unwrap().p_value > 1e-3);
    // Of a sky of 300 electrons greens scatter by about 36 counts, and others by less.
    let noise_dn = found.codes.unwrap().noise_dn.unwrap();
    assert!((15.0..60.0).contains(&noise_dn), "{noise_dn}");
}

/// Where a single exposure is not known, seconds and frames are not mixed.
#[test]
fn a_missing_exposure_makes_all_count_as_frames() {
    let frames = frames(&Camera::default(), &SKIES, 4);
    let ratio = |exposure_s: &dyn Fn(usize) -> Option<f64>| {
        let found = statistics_of(&Camera::default(), &frames, exposure_s);
        let by = |number: usize| {
            let is_own = |pair: &&PatternPair| pair.frames == [number, number + 1];
            found.fixed_pattern.pairs.iter().find(is_own).unwrap().by_exposure
        };
        by(0) / by(2)
    };
    // Frames differ by their noise too, which is the same whatever their exposures.
    let by_noise = ratio(&|_| Some(1.0));
    assert!((ratio(&|number| Some(if number < 2 { 10.0 } else { 1.0 })) / by_noise - 100.0).abs() < 1e-6);
    assert!((ratio(&|number| (number > 0).then_some(10.0)) / by_noise - 1.0).abs() < 1e-6);
}

/// Neighbours that were joined have less noise, and would tell a gain that is too high.
#[test]
fn smoothed_frames_tell_no_gain() {
    let plain = frames(&Camera::default(), &SKIES, 5);
    let mut smooth = plain.clone();
    for (frame, _) in &mut smooth {
        let (own, width) = (frame.pixels_dn.clone(), frame.width_px);
        for index in 0..own.len() - width - 1 {
            frame.pixels_dn[index] = 0.25 * (own[index] + own[index + 1] + own[index + width] + own[index + width + 1]);
        }
    }
    let told = |frames: &[(Frame, Vec<StarDisc>)]| {
        let found = statistics_of(&Camera::default(), frames, |_| Some(1.0));
        (found.altered_noise().is_some(), found.photon_transfer.unwrap().gain_e_per_dn.is_some())
    };
    assert_eq!((told(&plain), told(&smooth)), ((false, true), (true, false)));
}

/// All groups of all frames are kept: every so many of them would be the darkest ones of each.
#[test]
fn points_of_long_recordings_are_kept() {
    let camera = Camera { side: 128, ..Camera::default() };
    let (frame, _) = &frames(&camera, &SKIES[..1], 6)[0];
    let sky = SkyFrame { number: 0, lowest_read_dn: 0.0, frame, stars: &[], bad: None, exposure_s: None, is_compared: false };
    let one = FrameStatistics::of(&sky).unwrap();
    let groups = one.points.len();
    let found = PixelStatistics::of(vec![one; 600], None, &KnownCamera::default());
    assert!(groups > 3 && found.transfer_points.len() == 600 * groups, "{groups}: {}", found.transfer_points.len());
}

/// Offsets of rows that go with those of their neighbours, and of columns, are no processing.
#[test]
fn banded_frames_tell_a_gain() {
    let mut all = frames(&Camera::default(), &SKIES, 7);
    let mut chance = Chance(99);
    for (frame, _) in &mut all {
        let (width, height) = (frame.width_px, frame.height_px);
        let mut offset = 0.0;
        let rows: Vec<f64> = (0..height)
            .map(|_| {
                offset = 0.6 * offset + 12.0 * chance.normal();
                offset
            })
            .collect();
        let columns: Vec<f64> = (0..width).map(|_| 8.0 * chance.normal()).collect();
        for (index, value) in frame.pixels_dn.iter_mut().enumerate() {
            *value = (*value + (rows[index / width] + columns[index % width]) as f32).round();
        }
    }
    let found = statistics_of(&Camera::default(), &all, |_| Some(1.0));
    let shared = found.neighbours.unwrap().all().map(|estimate| estimate.value);
    println!("{shared:.4?}");
    // Less than what is told as a memory of the read-out.
    assert!(shared.iter().all(|value| value.abs() < 0.006), "{shared:?}");
    assert!(found.altered_noise().is_none());
}

/// A converter that has no count below 0 cuts the noise of a dark sky off: less is left of it the darker it is, which looks like a gain.
#[test]
fn noise_that_is_cut_off_at_zero_tells_no_gain() {
    let camera = Camera { bias: 0.0, ..Camera::default() };
    let dark: Vec<f64> = SKIES.iter().map(|sky| sky / 100.0).collect();
    let whole = frames(&camera, &dark, 8);
    let mut cut = whole.clone();
    for (frame, _) in &mut cut {
        frame.pixels_dn.iter_mut().for_each(|value| *value = value.max(0.0));
    }
    assert!(statistics_of(&camera, &whole, |_| Some(1.0)).altered_noise().is_none());
    let found = statistics_of(&camera, &cut, |_| Some(1.0));
    assert!(found.altered_noise().unwrap().contains("cut off"));
    assert!(found.photon_transfer.and_then(|line| line.gain_e_per_dn).is_none());
    // A dark that is taken off brings no noise back.
    let mut calibrated = cut.clone();
    for (frame, _) in &mut calibrated {
        frame.pixels_dn.iter_mut().step_by(7).for_each(|value| *value -= 1.0);
    }
    assert!(statistics_as_read(&camera, &calibrated, |_| Some(1.0), |_| 0.0).altered_noise().unwrap().contains("cut off"));
    // Higher up nothing is lost.
    let high = Camera { bias: 20.0, ..Camera::default() };
    assert!(statistics_of(&high, &frames(&high, &dark, 8), |_| Some(1.0)).altered_noise().is_none());
}

/// Stars that were not found are no processing; interpolated colours, resampling, smoothing and sharpening are.
#[test]
fn a_dense_sky_is_no_processing() {
    let of = |[axes, diagonals]: [f64; 2]| {
        let [along, across] = [axes, diagonals].map(|value| Estimate { value, sigma: 0.001 });
        let [column, row, diagonal, antidiagonal] = [along, along, across, across];
        NeighbourCorrelation { column, row, diagonal, antidiagonal, ..NeighbourCorrelation::default() }.is_of_processing()
    };
    assert!(!of([0.093, 0.066]));
    // Resampled by half a pixel, smoothed, and sharpened.
    assert!(of([0.5, 0.25]) && of([0.78, 0.61]) && of([-0.2, 0.03]));
    let remembers = Estimate { value: 0.5, sigma: 0.001 };
    assert!(!NeighbourCorrelation { column: remembers, ..NeighbourCorrelation::default() }.is_of_processing());
}
