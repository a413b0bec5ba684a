//! Copies and halos of bright stars on painted frames: what is painted is named with its size, and winged images and stars that are not found are not.

use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;

use super::copies::copies;
use super::halo::{self, halo};
use crate::diagnose::diagnosis::{EffectState, EffectStatus, Finding};
use crate::frame::Frame;
use crate::pixel_statistics::{CopiesFrame, ElsewhereFrame, FoundStar, LOOKS, StarDisc, halo_share};

const SIDE: usize = 300;
const FRAMES: usize = 12;
const SKY_DN: f64 = 100.0;
const NOISE_DN: f64 = 5.0;
const SIGMA_PX: f64 = 1.1;
/// A fainter star is not found, DN.
const FAINTEST_DN: f64 = 120.0;

/// What is wrong with the frames, as shares of the light of each star.
#[derive(Clone, Copy, Debug, Default)]
struct Wrong {
    crosstalk: f64,
    ghost: f64,
    /// Width of the ghost's image, px.
    ghost_px: f64,
    persistence: f64,
    halo: f64,
}

#[derive(Clone, Copy, Debug)]
struct World {
    seed: u64,
    /// Moffat images.
    is_winged: bool,
    /// The camera follows the stars.
    is_static: bool,
    wrong: Wrong,
}

/// Column, row, light.
type Star = [f64; 3];

impl World {
    fn plain(seed: u64) -> Self {
        Self { seed, is_winged: false, is_static: false, wrong: Wrong::default() }
    }

    /// Stars of each frame: a few hundred, most of them too faint to be found.
    fn stars(&self, rng: &mut Pcg64Mcg) -> Vec<Vec<Star>> {
        let across = 3.0 * SIDE as f64;
        let sky: Vec<Star> = (0..1600)
            .map(|_| [across * rng.random::<f64>(), across * rng.random::<f64>(), 40.0 * rng.random::<f64>().powf(-1.6).min(8e3)])
            .collect();
        let mut at = [SIDE as f64; 2];
        let mut all = Vec::new();
        for _ in 0..FRAMES {
            if !self.is_static {
                at = [0, 1].map(|_| 2.0 * SIDE as f64 * rng.random::<f64>());
            }
            let own = sky.iter().map(|star| [star[0] - at[0], star[1] - at[1], star[2]]);
            let is_inside = |star: &Star| star[..2].iter().all(|at| *at > 0.0 && *at < SIDE as f64 - 1.0);
            all.push(own.filter(is_inside).collect());
        }
        all
    }

    fn shine(light: &mut [f64], [x, y, flux]: Star, sigma_px: f64, is_winged: bool) {
        let reach = if is_winged && flux > 2e3 { SIDE as f64 } else { 8.0 * sigma_px };
        let span = |at: f64| (at - reach).max(0.0) as usize..((at + reach) as usize + 1).min(SIDE);
        for (row, column) in span(y).flat_map(|row| span(x).map(move |column| (row, column))) {
            let square = (column as f64 - x).powi(2) + (row as f64 - y).powi(2);
            light[row * SIDE + column] += flux
                * if is_winged {
                    let (alpha2, beta) = (3.0, 2.3);
                    (beta - 1.0) / (std::f64::consts::PI * alpha2) * (1.0 + square / alpha2).powf(-beta)
                } else {
                    (-0.5 * square / sigma_px.powi(2)).exp() / (std::f64::consts::TAU * sigma_px.powi(2))
                };
        }
    }

    fn frames(&self) -> Vec<ElsewhereFrame> {
        let mut rng = Pcg64Mcg::seed_from_u64(self.seed);
        let stars = self.stars(&mut rng);
        let painted: Vec<(Frame, Vec<FoundStar>)> = (0..FRAMES).map(|number| self.frame(&stars, number, &mut rng)).collect();
        let of = |number: usize| {
            let (frame, stars) = &painted[number];
            let before = number.checked_sub(1).map_or(&[][..], |before| &painted[before].1);
            ElsewhereFrame::of(number, &CopiesFrame { frame, stars, before, bad: None, sigma_px: SIGMA_PX, noise_dn: NOISE_DN })
        };
        (0..FRAMES).map(of).collect()
    }

    fn frame(&self, stars: &[Vec<Star>], number: usize, rng: &mut Pcg64Mcg) -> (Frame, Vec<FoundStar>) {
        let wrong = self.wrong;
        let mut light = vec![SKY_DN; SIDE * SIDE];
        let last = SIDE as f64 - 1.0;
        // What a search would find, copies too.
        let mut found = stars[number].clone();
        stars[number].iter().for_each(|star| Self::shine(&mut light, *star, SIGMA_PX, self.is_winged));
        for [x, y, flux] in stars[number].iter().copied() {
            let ghost = [last - x, last - y, wrong.ghost * flux];
            if wrong.ghost > 0.0 {
                Self::shine(&mut light, ghost, wrong.ghost_px, false);
            }
            found.extend((wrong.ghost_px < 2.0).then_some(ghost));
            found.push([last - x, y, wrong.crosstalk * flux]);
        }
        if wrong.persistence > 0.0 && number > 0 {
            for [x, y, flux] in stars[number - 1].iter().copied() {
                let left = [x, y, wrong.persistence * flux];
                Self::shine(&mut light, left, SIGMA_PX, self.is_winged);
                found.push(left);
            }
        }
        if wrong.halo > 0.0 {
            for [x, y, flux] in stars[number].iter().copied().filter(|star| star[2] > 2e3) {
                for (k, value) in light.iter_mut().enumerate() {
                    let square = ((k % SIDE) as f64 - x).powi(2) + ((k / SIDE) as f64 - y).powi(2);
                    *value += wrong.halo * flux / halo_share(25.0, SIDE as f64) / (1.0 + square / 625.0);
                }
            }
        }
        for row in light.chunks_exact_mut(SIDE) {
            let before = row.to_vec();
            row.iter_mut().zip(before.iter().rev()).for_each(|(value, other)| *value += wrong.crosstalk * other);
        }
        let mut normal = || -> f64 { StandardNormal.sample(&mut *rng) };
        let pixels_dn = light
            .into_iter()
            .map(|value| (value + (NOISE_DN.powi(2) + value - SKY_DN).max(0.0).sqrt() * normal()).round() as f32)
            .collect();
        let reach = |flux: f64| {
            let ratio = flux / (std::f64::consts::TAU * SIGMA_PX.powi(2)) / (0.1 * NOISE_DN);
            1.6 * SIGMA_PX * (2.0 * ratio.max(1.0).ln()).sqrt() + 2.0
        };
        let mut found: Vec<FoundStar> = found
            .into_iter()
            .filter(|star| star[2] > FAINTEST_DN)
            .map(|[x_px, y_px, flux_dn]| FoundStar {
                disc: StarDisc { x_px, y_px, radius_px: reach(flux_dn) },
                flux_dn,
                is_whole: x_px.min(y_px) > 4.0 && x_px.max(y_px) < last - 4.0,
                is_full: false,
            })
            .collect();
        found.sort_by(|a, b| b.flux_dn.total_cmp(&a.flux_dn));
        (Frame { width_px: SIDE, height_px: SIDE, pixels_dn, saturation_dn: 1e9 }, found)
    }

    fn told(&self) -> Vec<(EffectStatus, Option<Finding>)> {
        let frames = self.frames();
        let mut all = copies(&frames, halo::TESTS);
        all.push(halo(&frames, LOOKS.len()));
        all.into_iter().map(super::counted::Counted::reported).collect()
    }
}

fn findings(told: &[(EffectStatus, Option<Finding>)]) -> Vec<&Finding> {
    told.iter().filter_map(|(_, finding)| finding.as_ref()).collect()
}

/// What is painted is all that is named, with its size and a useful error.
fn named(world: World, id: &str, truth: f64) -> Finding {
    let told = world.told();
    let findings = findings(&told);
    let ids: Vec<&str> = findings.iter().map(|finding| finding.id.as_str()).collect();
    assert_eq!(ids, [id], "{world:?}: {told:?}");
    let size = &findings[0].parameters[0];
    assert!((size.value - truth).abs() < 3.0 * size.sigma && size.sigma < truth.abs() / 5.0, "{world:?}: {size:?}");
    findings[0].clone()
}

#[test]
fn crosstalk_is_named_with_its_size() {
    for (seed, crosstalk, is_winged) in [(1, 0.002, false), (2, 0.002, true), (3, -0.002, false), (4, 0.02, false)] {
        let wrong = Wrong { crosstalk, ..Wrong::default() };
        let found = named(World { is_winged, wrong, ..World::plain(seed) }, "crosstalk", crosstalk);
        assert!(found.sentence.contains("mirrored column"), "{}", found.sentence);
    }
}

#[test]
fn a_ghost_is_named_with_its_size() {
    for (seed, ghost_px) in [(11, SIGMA_PX), (12, 4.0)] {
        let wrong = Wrong { ghost: 0.006, ghost_px, ..Wrong::default() };
        let world = World { wrong, ..World::plain(seed) };
        let told = world.told();
        let findings = findings(&told);
        let ids: Vec<&str> = findings.iter().map(|finding| finding.id.as_str()).collect();
        assert_eq!(ids, ["ghost"], "{told:?}");
        // A copy as sharp as the stars may be of two amplifiers, one out of focus is of the lens.
        assert_eq!(findings[0].indistinguishable_from.is_empty(), ghost_px > 2.0, "{:?}", findings[0]);
        let size = &findings[0].parameters[0];
        // A weight that is not quite as wide as the ghost sees the star's light otherwise than the ghost's.
        let share = if ghost_px > 2.0 { 0.25 } else { 0.0 };
        assert!((size.value - 0.006).abs() < 3.0 * size.sigma + 2.0 * share * 0.006, "{size:?}");
    }
}

#[test]
fn persistence_is_named_with_its_size() {
    let wrong = Wrong { persistence: 0.004, ..Wrong::default() };
    named(World { wrong, ..World::plain(21) }, "persistence", 0.004);
}

#[test]
fn a_halo_is_named_with_its_size() {
    for is_winged in [false, true] {
        let wrong = Wrong { halo: 0.08, ..Wrong::default() };
        let told = World { is_winged, wrong, ..World::plain(31) }.told();
        let findings = findings(&told);
        let ids: Vec<&str> = findings.iter().map(|finding| finding.id.as_str()).collect();
        assert_eq!(ids, ["veiling-glare"], "{told:?}");
        let share = findings[0].parameters[0].value;
        assert!((0.05..0.12).contains(&share), "{share}");
    }
}

/// Wings, stars that were not found, and frames that show the same stars at the same places.
#[test]
fn nothing_is_named_where_nothing_is() {
    const SEEDS: u64 = 16;
    let mut surprising = 0;
    for seed in 100..100 + SEEDS {
        let world = World { is_winged: seed % 2 == 0, is_static: seed % 4 > 1, ..World::plain(seed) };
        let told = world.told();
        assert!(findings(&told).is_empty(), "{world:?}: {told:?}");
        assert_eq!(told.len(), 4);
        for (status, _) in &told {
            assert!(status.status == EffectState::NotFound || (world.is_static && status.id == "persistence"), "{status:?}");
            surprising += usize::from(status.p_value.is_some_and(|p| p < 0.01));
        }
    }
    // The probabilities are those of the best of all looks: one or none of 64 is due, 6 come once in ten thousand times.
    assert!(surprising < 6, "{surprising} of {} probabilities are below a hundredth", 4 * SEEDS);
}
