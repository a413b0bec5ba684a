//! Stars of the renderer: images of real optics, and what goes wrong with stars (trails, saturation, neighbours), measured against its truth.

use boresight::catalog::{Catalog, Star};
use boresight::coordinates::{Attitude, Direction};
use boresight::detect::{DetectOptions, Detection, Detections, detect};
use boresight::frame::Frame;
use boresight::imaging::Backend;
use boresight::render::{Renderer, TrueStar};
use boresight::scene::Scene;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use rayon::prelude::*;

use super::drawn::{Detector, Image, electrons_for};

pub(crate) const SIDE_PX: usize = 1024;
const FOCAL_PX: f64 = 4000.0;
/// Distance of the stars' cells, and how far stars lie from the middles of these, at most.
const PITCH_PX: usize = 64;
const ASIDE_PX: f64 = 12.0;
/// How far frames point from another, at most, px: other phases of the same stars.
const DITHER_PX: f64 = 2.0;
/// A star of magnitude 5 gives so many electrons.
const ELECTRONS_AT_5: f64 = 1e5;
const GAIN_E_PER_DN: f64 = 1.5;
const READ_NOISE_E: f64 = 4.0;
const SKY_E: f64 = 120.0;

const TOP_DN: f64 = 65_535.0;
/// A round Gaussian of this width where nothing else is said.
const SIGMA_PX: f64 = 1.1;
const BORESIGHT_RAD: [f64; 2] = [1.4, 0.1];

/// What is drawn into each cell: stars by their places from its middle and their electrons.
type Group = Vec<([f64; 2], f64)>;

/// Frames of groups that stand alone, of stars smeared by so many pixels across and down.
pub(crate) struct Night {
    groups: Vec<Group>,
    /// The image of a star as scenes describe it, if it is no round Gaussian.
    psf: &'static str,
    trail_px: [f64; 2],
    frames: usize,
    seed: u64,
}

impl Night {
    pub(crate) fn new(trail_px: [f64; 2], frames: usize, seed: u64, mut group: impl FnMut(&mut Pcg64) -> Group) -> Self {
        let mut rng = Pcg64::seed_from_u64(seed);
        let groups = (0..(SIDE_PX / PITCH_PX).pow(2)).map(|_| group(&mut rng)).collect();
        Self { groups, psf: "", trail_px, frames, seed }
    }

    /// The same with another image.
    pub(crate) fn with_image(self, psf: &'static str) -> Self {
        Self { psf, ..self }
    }

    /// Stars where the first frame shows them, group after group.
    fn catalog(&self) -> Catalog {
        let mut rng = Pcg64::seed_from_u64(self.seed + 1_000_000);
        let attitude = Attitude::from_pointing(BORESIGHT_RAD[0], BORESIGHT_RAD[1], 0.0);
        let cells = SIDE_PX / PITCH_PX;
        let middle = 0.5 * (SIDE_PX as f64 - 1.0);
        let mut stars = Vec::new();
        for (i, group) in self.groups.iter().enumerate() {
            let mut place = |cell: usize| ((cell * PITCH_PX + PITCH_PX / 2) as f64) + rng.random_range(-ASIDE_PX..ASIDE_PX);
            let [x, y] = [place(i % cells), place(i / cells)];
            for ([dx, dy], electrons) in group {
                let light = Direction::along([x + dx - middle, y + dy - middle, FOCAL_PX]);
                stars.push(Star {
                    hip: stars.len() as u32 + 1,
                    direction: Direction::from_unit(attitude.apparent_from_camera(&light).xyz),
                    proper_motion_rad_yr: None,
                    parallax_rad: 0.0,
                    magnitude: 5.0 - 2.5 * (electrons / ELECTRONS_AT_5).log10(),
                    colour: None,
                });
            }
        }
        Catalog::new(stars, 2000.0, "stars of a study".to_owned(), String::new())
    }

    fn scene(&self) -> Scene {
        let zero_point = ELECTRONS_AT_5 * 100.0;
        let mut rng = Pcg64::seed_from_u64(self.seed + 2_000_000);
        // turning about x moves stars along y, and the other way round
        let rate = [self.trail_px[1], -self.trail_px[0]].map(|px| (px / FOCAL_PX).to_degrees());
        let mut text = format!(
            "format = \"boresight-scene/1\"\nseed = {}\n[camera]\nwidth_px = {SIDE_PX}\nheight_px = {SIDE_PX}\n\
             focal_length_px = {FOCAL_PX:.1}\n[detector]\npsf_sigma_px = {SIGMA_PX}\nzero_point_e_per_s = {zero_point:.1}\n\
             gain_e_per_dn = {GAIN_E_PER_DN}\nbias_dn = 100.0\nread_noise_e = {READ_NOISE_E:.1}\nsaturation_dn = {TOP_DN:.1}\n\
             full_well_e = 1.0e9\n[sky]\nbackground_e_per_px_s = {SKY_E:.1}\nfaintest_magnitude = 20.0\nphysics = \"none\"\n",
            self.seed
        );
        text.push_str(self.psf);
        for _ in 0..self.frames {
            let mut aside = |at: f64| (at + rng.random_range(-DITHER_PX..DITHER_PX) / FOCAL_PX).to_degrees();
            let [ra, dec] = BORESIGHT_RAD.map(&mut aside);
            text.push_str(&format!(
                "[[frames]]\nexposure_s = 1.0\nboresight_radec_deg = [{ra:.8}, {dec:.8}]\nrate_deg_s = [{:.8}, {:.8}, 0.0]\n",
                rate[0], rate[1]
            ));
        }
        Scene::parse("study.toml", &text).expect("a scene as scenes are written")
    }

    /// Detections of all frames, each with the truth of its stars.
    fn measured(&self, options: &DetectOptions) -> Vec<(Detections, Vec<TrueStar>)> {
        self.frames(|frame, stars| (detect(frame, options).expect("a frame that can be measured"), stars))
    }

    /// What `look` makes of each frame and its truth.
    pub(crate) fn frames<T: Send>(&self, look: impl Fn(&Frame, Vec<TrueStar>) -> T + Sync) -> Vec<T> {
        let (scene, catalog) = (self.scene(), self.catalog());
        let renderer = Renderer::new(&scene, &catalog, Backend::Cpu).expect("a scene that can be rendered");
        let one = |index: usize| {
            let rendered = renderer.render(index).expect("a frame that can be rendered");
            let pixels_dn = rendered.pixels_dn.iter().map(|v| f32::from(*v)).collect();
            let frame = Frame { width_px: SIDE_PX, height_px: SIDE_PX, pixels_dn, saturation_dn: TOP_DN as f32 };
            look(&frame, rendered.stars)
        };
        (0..self.frames).into_par_iter().map(one).collect()
    }
}

/// Electrons of a round star with this signal-to-noise ratio.
pub(crate) fn electrons(snr: f64) -> f64 {
    let image = Image::gaussian(SIGMA_PX);
    electrons_for(snr, &image, SKY_E, &Detector { gain_e_per_dn: GAIN_E_PER_DN, read_noise_e: READ_NOISE_E, bias_dn: 100.0, top_dn: 1e9 })
}

/// What was found of stars.
#[derive(Default)]
struct Tally {
    stars: f64,
    found: f64,
    /// Detections near a star that are no star's.
    others: f64,
    saturated: f64,
    blended: f64,
    /// Σ of errors along a direction and across it, of their squares, and of squared pulls along columns and rows.
    error: [f64; 2],
    error2: [f64; 2],
    pull2: f64,
    /// Σ of measured over true flux, and of squared pulls of it.
    flux: f64,
    flux_pull2: f64,
}

impl Tally {
    /// `direction`: of each star's errors, from its truth and its group's others. A detection is the nearest star's, within `reach_px`.
    fn of(
        frames: &[(Detections, Vec<TrueStar>)],
        reach_px: f64,
        take: impl Fn(&TrueStar) -> bool,
        along: impl Fn(&TrueStar) -> [f64; 2],
    ) -> Self {
        let mut tally = Self::default();
        for (found, truth) in frames {
            let far = |d: &Detection, s: &TrueStar| (d.x_px - s.x_mean_px).hypot(d.y_px - s.y_mean_px);
            let mut taken = vec![false; found.stars.len()];
            for star in truth.iter().filter(|s| !s.edge) {
                // each detection belongs to the star that it is nearest to
                let own = |d: &Detection| truth.iter().all(|other| far(d, other) >= far(d, star));
                let near = found.stars.iter().enumerate().filter(|(_, d)| far(d, star) < reach_px && own(d));
                let best = near.min_by(|a, b| far(a.1, star).total_cmp(&far(b.1, star)));
                if let Some((k, _)) = best {
                    taken[k] = true;
                }
                if !take(star) {
                    continue;
                }
                tally.stars += 1.0;
                if let Some((_, d)) = best {
                    tally.take(d, star, along(star));
                }
            }
            let near = |d: &Detection| truth.iter().any(|s| far(d, s) < 20.0 && !s.edge);
            tally.others += found.stars.iter().zip(&taken).filter(|(d, taken)| !**taken && near(d)).count() as f64;
        }
        tally
    }

    fn take(&mut self, d: &Detection, star: &TrueStar, along: [f64; 2]) {
        self.found += 1.0;
        self.saturated += f64::from(u8::from(d.flags.saturated));
        self.blended += f64::from(u8::from(d.flags.blended));
        let error = [d.x_px - star.x_mean_px, d.y_px - star.y_mean_px];
        let turned = [error[0] * along[0] + error[1] * along[1], error[1] * along[0] - error[0] * along[1]];
        for ((sum, square), error) in self.error.iter_mut().zip(&mut self.error2).zip(turned) {
            *sum += error;
            *square += error * error;
        }
        let [xx, xy, yy] = d.covariance_px2;
        // χ² of the place over its two degrees of freedom
        let determinant = xx * yy - xy * xy;
        self.pull2 += (yy * error[0] * error[0] - 2.0 * xy * error[0] * error[1] + xx * error[1] * error[1]) / (2.0 * determinant);
        let flux_dn = star.electrons_landed / GAIN_E_PER_DN;
        self.flux += d.flux_dn / flux_dn;
        self.flux_pull2 += ((d.flux_dn - flux_dn) / d.flux_sigma_dn).powi(2);
    }

    fn line(&self) -> String {
        let n = self.found.max(1.0);
        let [along, across] = [0, 1].map(|k| (self.error[k] / n, (self.error2[k] / n - (self.error[k] / n).powi(2)).max(0.0).sqrt()));
        format!(
            "{:6.0} {:.4} {:.4}   {:8.4} {:8.4}  {:8.4} {:8.4}   {:9.3}   {:7.4} {:9.3}    {:.2} {:.2}",
            self.stars,
            self.found / self.stars,
            self.others / self.stars,
            along.0,
            along.1,
            across.0,
            across.1,
            self.pull2 / n,
            self.flux / n,
            self.flux_pull2 / n,
            self.saturated / n,
            self.blended / n
        )
    }
}

pub(crate) fn options() -> DetectOptions {
    DetectOptions { gain_e_per_dn: Some(GAIN_E_PER_DN), read_noise_e: Some(READ_NOISE_E), ..DetectOptions::default() }
}

const HEAD: &str = " stars  found others   along: mean, rms     across: mean, rms       place  flux: ratio, flux    saturated blended";

/// Trails, saturated stars and pairs.
pub(crate) fn tables(frames: usize, line: &mut impl FnMut(&str)) {
    line(&format!(
        "\nStars of the renderer (σ {SIGMA_PX} px, SNR of the round star alone), gain and read noise known, width not. Errors against the mean place of the light,\n\
         along the trail or towards the neighbour, and across; place and flux: squared errors over what was stated, 1 where errors are true.\n\
         others: detections within 20 px that are no star's, per star."
    ));
    line(&format!("Trails, px  SNR  {HEAD}"));
    for (k, trail) in [0.0, 2.0, 5.0, 10.0, 20.0].into_iter().enumerate() {
        for (j, snr) in [30.0, 100.0, 300.0].into_iter().enumerate() {
            let light = electrons(snr);
            let turned: f64 = 0.5;
            let night =
                Night::new([trail * turned.cos(), trail * turned.sin()], frames, (100 + 10 * k + j) as u64, |_| vec![([0.0; 2], light)]);
            let tally = Tally::of(&night.measured(&options()), 3.0, |_| true, |_| [turned.cos(), turned.sin()]);
            line(&format!("{trail:10.0} {snr:4.0}  {}", tally.line()));
        }
    }
    line(&format!("Saturated: peak over the converter's top  {HEAD}"));
    for (k, over) in [0.5, 1.2, 2.0, 5.0, 20.0, 100.0].into_iter().enumerate() {
        let peak = 0.125;
        let light = over * TOP_DN * GAIN_E_PER_DN / peak;
        let night = Night::new([0.0; 2], frames, 200 + k as u64, |_| vec![([0.0; 2], light), ([26.0, 20.0], electrons(100.0))]);
        let tally = Tally::of(&night.measured(&options()), 3.0, |s| s.electrons_asked > 0.5 * light, |_| [1.0, 0.0]);
        line(&format!("{over:10.1}       {}", tally.line()));
    }
    // one cell in four holds a pair, the others tell the image
    for ratio in [1.0, 4.0] {
        line(&format!("Pairs, {ratio} times as bright: distance, px  SNR of the fainter  {HEAD}"));
        for (k, distance) in [2.0, 2.5, 3.0, 4.0, 5.0, 6.0].into_iter().enumerate() {
            for (j, snr) in [30.0, 100.0, 300.0].into_iter().enumerate() {
                let light = electrons(snr);
                let seed = 300 + 20 * k as u64 + j as u64 + ratio as u64 * 1000;
                let night = Night::new([0.0; 2], frames, seed, |rng| {
                    let (s, c) = rng.random_range(0.0..std::f64::consts::TAU).sin_cos();
                    if rng.random_range(0..4) == 0 {
                        vec![([0.0; 2], light), ([distance * c, distance * s], ratio * light)]
                    } else {
                        vec![([0.0; 2], ratio * electrons(snr * rng.random_range(0.7..3.0)))]
                    }
                });
                let frames = night.measured(&options());
                // the stars' numbers are those of the groups in turn; the first of a pair is the fainter
                let mut towards_neighbour = vec![None];
                for group in &night.groups {
                    towards_neighbour.push(group.get(1).map(|([dx, dy], _)| [dx / distance, dy / distance]));
                    towards_neighbour.extend(group.get(1).map(|_| None));
                }
                let of_pair = |s: &TrueStar| towards_neighbour[s.hip as usize].is_some();
                let towards = |s: &TrueStar| towards_neighbour[s.hip as usize].unwrap_or([1.0, 0.0]);
                let tally = Tally::of(&frames, 0.5 * distance, of_pair, towards);
                line(&format!("{distance:10.1} {snr:4.0}  {}", tally.line()));
            }
        }
    }
}
