//! What the device does with a whole frame before it is read back, joining pixels and putting light behind filters, beside the twins on the CPU.

use boresight::imaging::{
    Backend, BinnedImager, Binning, BinningPlace, EffectSetting, FilterLight, Imager, ImagingConfig, PlacedStar, SplitLimits, join_program,
    mosaic_program,
};

use crate::stages::{far_apart, members, parse};
use crate::twins::{config, cpu, exposure, gpu, sky};

/// Whole electrons, of which some are beyond the full well, so that nothing is rounded before pixels are joined.
fn whole_electrons(pixels: usize) -> Vec<f32> {
    (0..pixels).map(|i| (i * 7919 % 61_001) as f32).collect()
}

fn detector(width: usize, height: usize) -> ImagingConfig {
    let parameters = [("gain_e_per_dn", 16.0), ("bias_dn", 100.0), ("full_well_e", 4e4), ("saturation_dn", 65_535.0), ("bits", 16.0)];
    config(width, height, vec![EffectSetting::new("adc", &parameters)])
}

/// Every way of joining.
fn ways() -> impl Iterator<Item = Binning> {
    let places = [BinningPlace::OnChip, BinningPlace::Digital];
    let ways = move |factor| places.into_iter().flat_map(move |place| [false, true].map(|is_mean| Binning { factor, is_mean, place }));
    (2..=4).flat_map(ways)
}

/// Expected electrons and counts of joined pixels, of a sky of these native ones.
fn joined(imager: &BinnedImager, sky_e: &[f32]) -> (Vec<f32>, Vec<u16>) {
    let exposure = boresight::imaging::FrameExposure { sky_e, ..exposure(&[], 0) };
    (imager.expected_electrons(&exposure, &[]).unwrap(), imager.expose_with(&exposure, &[]).unwrap().pixels_dn)
}

/// The device joins as the twins do, to the last bit, in one buffer and in several; and one native pixel that is different is seen in its joined one
/// and in no other.
#[test]
fn pixels_are_joined_on_the_device_as_on_the_cpu() {
    for binning in ways() {
        let (width, height) = (31 * binning.factor, 53 * binning.factor);
        let config = detector(width, height);
        let mut sky_e = whole_electrons(width * height);
        let on_cpu = joined(&BinnedImager::new(Backend::Cpu, &config, binning).unwrap(), &sky_e);
        let sum: f64 = sky_e.iter().map(|e| f64::from(*e)).sum();
        let sum_joined: f64 = on_cpu.0.iter().map(|e| f64::from(*e)).sum();
        assert!(on_cpu.0.len() == 31 * 53 && sum == sum_joined, "{binning:?}: {sum} {sum_joined}");
        let test = "pixels_are_joined_on_the_device_as_on_the_cpu";
        if gpu(test, &config, SplitLimits::default()).is_none() {
            return;
        }
        for buffer_bytes in [128 << 20, width as u64 * 4 * 100, 500] {
            let limits = SplitLimits { buffer_bytes, ..SplitLimits::default() };
            let imager = BinnedImager::with_limits(Backend::Gpu, &config, binning, limits).unwrap();
            assert_eq!(joined(&imager, &sky_e), on_cpu, "{binning:?}, buffers of {buffer_bytes} bytes");
        }
        let (x, y) = (width - 2, height / 2);
        sky_e[y * width + x] = if sky_e[y * width + x] > 2e4 { 0.0 } else { 3e4 };
        let other = joined(&BinnedImager::new(Backend::Gpu, &config, binning).unwrap(), &sky_e);
        let differing = (0..31 * 53).filter(|i| other.0[*i] != on_cpu.0[*i]).collect::<Vec<_>>();
        assert_eq!(differing, [y / binning.factor * 31 + x / binning.factor], "{binning:?}");
        let differing = (0..31 * 53).filter(|i| other.1[*i] != on_cpu.1[*i]).collect::<Vec<_>>();
        assert_eq!(differing, [y / binning.factor * 31 + x / binning.factor], "{binning:?}");
    }
}

/// Stars behind red, green and blue filters.
fn behind(imager: &Imager, stars: [&[PlacedStar]; 3], sky_e: &[f32]) -> Vec<f32> {
    let lights = stars.map(|stars| FilterLight { stars, planes: Vec::new() });
    imager.behind_filters(&boresight::imaging::FrameExposure { sky_e, ..exposure(&[], 0) }, &lights).unwrap()
}

/// Light behind filters: the device and the twin, in one buffer and in several, with a sky and without; filters that change places are seen.
#[test]
fn light_is_put_behind_filters_on_the_device_as_on_the_cpu() {
    let test = "light_is_put_behind_filters_on_the_device_as_on_the_cpu";
    for (width, height) in [(123, 70), (40, 33)] {
        let config = config(width, height, vec![]);
        let red = sky(90, width, height, 3);
        let [green, blue] = [0.7, 0.4]
            .map(|share| -> Vec<_> { red.iter().map(|star| PlacedStar { electrons: share * star.electrons, ..*star }).collect() });
        let light = [&red[..], &green, &blue];
        let twin = cpu(&config);
        let Some(whole) = gpu(test, &config, SplitLimits::default()) else { return };
        for sky_e in [vec![], whole_electrons(width * height)] {
            let on_cpu = behind(&twin, light, &sky_e);
            let on_gpu = behind(&whole, light, &sky_e);
            assert_eq!(far_apart(&on_gpu, &on_cpu), 0, "{width} × {height} px");
            assert_eq!(behind(&whole, light, &sky_e), on_gpu, "a second time");
            for buffer_bytes in [width as u64 * 4 * 16, 500] {
                let split =
                    gpu(test, &config, SplitLimits { buffer_bytes, ..SplitLimits::default() }).expect("there was an adapter before");
                assert_eq!(behind(&split, light, &sky_e), on_gpu, "buffers of {buffer_bytes} bytes");
            }
            let swapped = behind(&whole, [light[2], light[1], light[0]], &sky_e);
            assert!(far_apart(&swapped, &on_cpu) > width * height / 8, "filters that change places are not seen");
        }
        // A pixel holds what its own filter lets through.
        let on_cpu = behind(&twin, light, &[]);
        let alone = [red, green, blue].map(|stars| twin.electrons_after(None, &exposure(&stars, 0)).unwrap());
        for (i, held) in on_cpu.iter().enumerate() {
            let filter = [[0, 1], [1, 2]][i / width % 2][i % width % 2];
            assert_eq!(*held, alone[filter][i], "pixel {i}");
        }
    }
}

#[test]
fn programs_for_whole_frames_are_sound() {
    let join = parse(&join_program(3));
    assert_eq!(members(&join, "Joining").1, 32);
    let mosaic = parse(&mosaic_program());
    assert_eq!(members(&mosaic, "Filter").1, 16);
    for (module, entry) in [(&join, "join"), (&join, "join_counts"), (&mosaic, "mosaic")] {
        assert!(module.entry_points.iter().any(|point| point.name == entry), "{entry}");
    }
}
