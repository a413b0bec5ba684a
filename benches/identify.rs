//! Identification under stress: star lists of a camera 15° wide with every nuisance that real images bring, and lists without stars.
//!
//! `cargo bench --bench identify -- [--trials N] [--star-free N] [--rows TEXT] [--python PROGRAM] [--page FILE]`. An answer is right if the
//! middle of the frame lies within 0.2°, the roll within a degree, the handedness is right and every star that it names is the one that was
//! put there; an attitude that is not right is `wrong`, a right attitude with another star's name on one of the detections is `misnamed`.
//! Time is that of this thread on the processor. With a Python that has tetra3rs, it is given the same lists through
//! `benches/peers/identify.py`; rows to whose width of field its database is not made are left to us alone.
#![allow(missing_docs, reason = "a bench is no interface")]
#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a bench that meets the unexpected must fail")]
#![allow(clippy::print_stdout, reason = "its table is what a bench is for")]

use std::fmt::Write as _;
use std::path::Path;
use std::process::Command;

use boresight::camera::Camera;
use boresight::catalog::Catalog;
use boresight::coordinates::{Attitude, Direction};
use boresight::detect::{Detection, Detections, Flags};
use boresight::identify::{Identification, IdentifyOptions, Index, Solution, identify};
use boresight::units::DEG_RAD;
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, Normal};
use rand_pcg::Pcg64Mcg;
use rustix::time::{ClockId, clock_gettime};

const SIDE_PX: usize = 1024;
/// Scatter of the measured magnitudes, as between two passbands.
const MAGNITUDE_SIGMA: f64 = 0.2;
/// A right answer is nearer than this to the truth.
const RIGHT_DEG: f64 = 0.2;

/// What is done to a star list.
#[derive(Clone, Copy)]
struct Scene {
    width_deg: f64,
    /// The faintest star, V.
    faintest: f64,
    noise_px: f64,
    /// Radial displacement in the corner; its sign changes from trial to trial.
    corner_px: f64,
    false_stars: usize,
    missing: f64,
    /// Only so many stars, the brightest.
    brightest: usize,
    mirrored: bool,
    /// Points by chance, from 4 to 200, and no star.
    star_free: bool,
}

const BASE: Scene = Scene {
    width_deg: 15.0,
    faintest: 6.0,
    noise_px: 0.1,
    corner_px: 0.0,
    false_stars: 0,
    missing: 0.0,
    brightest: usize::MAX,
    mirrored: false,
    star_free: false,
};

/// A row of the table.
struct Row {
    name: &'static str,
    scene: Scene,
    /// The focal length that is told is wrong by this factor (up and down in turn), and the tolerance that is told with it.
    /// `None`: nothing is told, all fields from 3° to 90° are searched.
    prior: Option<(f64, f64)>,
}

const TEN: Option<(f64, f64)> = Some((1.0, 0.1));

#[rustfmt::skip]
fn rows() -> Vec<Row> {
    let row = |name, scene, prior| Row { name, scene, prior };
    vec![
        row("base", BASE, TEN),
        row("noise 1 px", Scene { noise_px: 1.0, ..BASE }, TEN),
        row("noise 2 px", Scene { noise_px: 2.0, ..BASE }, TEN),
        row("radial 12.5 px", Scene { corner_px: 12.5, ..BASE }, TEN),
        row("radial 25 px", Scene { corner_px: 25.0, ..BASE }, TEN),
        row("radial 50 px", Scene { corner_px: 50.0, ..BASE }, TEN),
        row("focal length x1.05", BASE, Some((1.05, 0.07))),
        row("focal length x1.10", BASE, Some((1.10, 0.14))),
        row("focal length x1.20", BASE, Some((1.20, 0.28))),
        row("10 false stars", Scene { false_stars: 10, ..BASE }, TEN),
        row("30 false stars", Scene { false_stars: 30, ..BASE }, TEN),
        row("100 false stars", Scene { false_stars: 100, ..BASE }, TEN),
        row("60 % missing", Scene { missing: 0.6, ..BASE }, TEN),
        row("6 brightest stars", Scene { brightest: 6, ..BASE }, TEN),
        row("V < 5", Scene { faintest: 5.0, ..BASE }, TEN),
        row("V < 4.7", Scene { faintest: 4.7, ..BASE }, TEN),
        row("V < 4.5", Scene { faintest: 4.5, ..BASE }, TEN),
        row("V < 4", Scene { faintest: 4.0, ..BASE }, TEN),
        row("mirrored", Scene { mirrored: true, ..BASE }, TEN),
        row("no prior: base", BASE, None),
        row("no prior: noise 1 px", Scene { noise_px: 1.0, ..BASE }, None),
        row("no prior: noise 2 px", Scene { noise_px: 2.0, ..BASE }, None),
        row("no prior: radial 25 px", Scene { corner_px: 25.0, ..BASE }, None),
        row("no prior: radial 50 px", Scene { corner_px: 50.0, ..BASE }, None),
        row("no prior: 30 false stars", Scene { false_stars: 30, ..BASE }, None),
        row("no prior: 100 false stars", Scene { false_stars: 100, ..BASE }, None),
        row("no prior: 60 % missing", Scene { missing: 0.6, ..BASE }, None),
        row("no prior: mirrored", Scene { mirrored: true, ..BASE }, None),
        row("no prior: 5° wide, V < 8", Scene { width_deg: 5.0, faintest: 8.0, ..BASE }, None),
        row("no prior: 40° wide, V < 5", Scene { width_deg: 40.0, faintest: 5.0, ..BASE }, None),
        row("no prior: 80° wide, V < 4", Scene { width_deg: 80.0, faintest: 4.0, ..BASE }, None),
        row("star-free", Scene { star_free: true, ..BASE }, TEN),
        row("no prior: star-free", Scene { star_free: true, ..BASE }, None),
    ]
}

struct List {
    detections: Detections,
    /// Index of the catalogue star behind each detection.
    names: Vec<Option<usize>>,
    attitude: Attitude,
    focal_px: f64,
}

fn detection(x_px: f64, y_px: f64, magnitude: f64) -> Detection {
    let flux_dn = 1e5 * 10_f64.powf(-0.4 * magnitude);
    Detection {
        x_px,
        y_px,
        covariance_px2: [0.01, 0.0, 0.01],
        flux_dn,
        flux_sigma_dn: flux_dn.sqrt(),
        background_dn: 100.0,
        background_gradient_dn: [0.0; 2],
        width_px: 1.0,
        chi2_per_dof: 1.0,
        peak_dn: flux_dn / 6.0,
        flags: Flags::default(),
    }
}

fn make(scene: &Scene, trial: u64) -> List {
    let mut rng = Pcg64Mcg::seed_from_u64(trial);
    let side = SIDE_PX as f64;
    let focal_px = side / 2.0 / (scene.width_deg * DEG_RAD / 2.0).tan();
    let corner_px = side / 2_f64.sqrt();
    let k1 = if trial.is_multiple_of(2) { 1.0 } else { -1.0 } * scene.corner_px / corner_px.powi(3);
    let camera = Camera { k1, ..Camera::pinhole(SIDE_PX, SIDE_PX, focal_px) };
    let mut turn = || rng.random_range(0.0..360.0) * DEG_RAD;
    let (ra, roll) = (turn(), turn());
    let attitude = Attitude::from_pointing(ra, rng.random_range(-1.0_f64..1.0).asin(), roll);
    let normal = Normal::new(0.0, 1.0).unwrap();
    let mut stars = Vec::new();
    let catalog = Catalog::embedded().stars.iter().enumerate();
    for (name, star) in catalog.take_while(|(_, star)| star.magnitude < scene.faintest && !scene.star_free) {
        let direction = attitude.camera_from_apparent(&Direction::from_unit(star.direction.xyz));
        let Some(point) = camera.pixel(&direction).filter(|point| camera.contains(*point)) else { continue };
        if rng.random_range(0.0..1.0) < scene.missing {
            continue;
        }
        let magnitude = star.magnitude + MAGNITUDE_SIGMA * normal.sample(&mut rng);
        let mut noise = || scene.noise_px * normal.sample(&mut rng);
        stars.push((detection(point.x_px + noise(), point.y_px + noise(), magnitude), Some(name)));
    }
    stars.truncate(scene.brightest);
    for _ in 0..if scene.star_free { rng.random_range(4..=200) } else { scene.false_stars } {
        let mut place = || rng.random_range(-0.5..side - 0.5);
        let (x, y) = (place(), place());
        stars.push((detection(x, y, rng.random_range(1.0..scene.faintest)), None));
    }
    if scene.mirrored {
        for (star, _) in &mut stars {
            star.x_px = side - 1.0 - star.x_px;
        }
    }
    stars.sort_by(|(a, _), (b, _)| b.flux_dn.total_cmp(&a.flux_dn));
    let (stars, names) = stars.into_iter().unzip();
    let detections = Detections { width_px: SIDE_PX, height_px: SIDE_PX, background_dn: 100.0, noise_dn: 3.0, stars };
    List { detections, names, attitude, focal_px }
}

/// CPU time of this thread, ms.
fn cpu_ms() -> f64 {
    let now = clock_gettime(ClockId::ThreadCPUTime);
    1e3 * now.tv_sec as f64 + 1e-6 * now.tv_nsec as f64
}

/// What came of the lists of a row.
#[derive(Default)]
struct Tally {
    right: usize,
    wrong: usize,
    misnamed: usize,
    ms: Vec<f64>,
}

impl Tally {
    /// The time below which this share of the lists stays.
    fn quantile_ms(&mut self, share: f64) -> f64 {
        self.ms.sort_by(f64::total_cmp);
        self.ms.get((self.ms.len() as f64 * share) as usize).copied().unwrap_or(f64::NAN)
    }

    fn percent(&self) -> f64 {
        100.0 * self.right as f64 / self.ms.len().max(1) as f64
    }

    fn cells(&mut self) -> String {
        let (median, late, most) = (self.quantile_ms(0.5), self.quantile_ms(0.95), self.ms[self.ms.len() - 1]);
        format!("{:7.2} {:6} {:9} {median:10.3} {late:10.2} {most:10.1}", self.percent(), self.wrong, self.misnamed)
    }
}

/// Whether middle, roll and handedness are right.
fn looks_right(list: &List, scene: &Scene, solution: &Solution) -> bool {
    let truth = list.attitude.apparent_from_camera(&Direction::from_unit([0.0, 0.0, 1.0]));
    let up = |attitude: &Attitude| attitude.apparent_from_camera(&Direction::from_unit([0.0, -1.0, 0.0]));
    !scene.star_free
        && truth.angle_rad(&solution.centre()) < RIGHT_DEG * DEG_RAD
        && up(&list.attitude).angle_rad(&up(&solution.attitude)) < DEG_RAD
        && (solution.parity < 0) == scene.mirrored
}

/// The focal length that is told of this trial, and how far it is trusted.
fn told(row: &Row, list: &List, trial: u64) -> Option<(f64, f64)> {
    let (factor, tolerance) = row.prior?;
    Some((if trial.is_multiple_of(2) { list.focal_px * factor } else { list.focal_px / factor }, tolerance))
}

fn ours(row: &Row, number: u64, trials: u64, index: &Index) -> Tally {
    let mut tally = Tally::default();
    for trial in 0..trials {
        let seed = number << 32 | trial;
        let list = make(&row.scene, seed);
        let prior = told(row, &list, trial);
        let options = IdentifyOptions {
            nominal_focal_length_px: prior.map(|(focal_px, _)| focal_px),
            focal_length_tolerance: prior.map_or(0.0, |(_, tolerance)| tolerance),
            search_beyond_tolerance: false,
            ..IdentifyOptions::default()
        };
        let begin = cpu_ms();
        let answer = identify(&list.detections, Catalog::embedded(), index, &[], &options);
        tally.ms.push(cpu_ms() - begin);
        if let (Identification::NotIdentified { reason }, false, Some(_)) =
            (&answer, row.scene.star_free, std::env::var_os("BORESIGHT_SHOW"))
        {
            println!("  {} trial {trial}: {} stars; {reason}", row.name, list.names.iter().flatten().count());
        }
        let Identification::Identified(solution) = answer else {
            tally.right += usize::from(row.scene.star_free);
            continue;
        };
        let misnamed = solution.matches.iter().filter(|one| list.names[one.detection] != Some(one.star)).count();
        match (looks_right(&list, &row.scene, &solution), misnamed) {
            (true, 0) => tally.right += 1,
            (true, _) => tally.misnamed += 1,
            (false, _) => tally.wrong += 1,
        }
        if std::env::var_os("BORESIGHT_SHOW").is_some() && (misnamed > 0 || !looks_right(&list, &row.scene, &solution)) {
            let truth = list.attitude.apparent_from_camera(&Direction::from_unit([0.0, 0.0, 1.0]));
            println!(
                "  {} trial {trial}: {misnamed} of {} misnamed, {:.3}° off, P {:.1e}",
                row.name,
                solution.matches.len(),
                truth.angle_rad(&solution.centre()) / DEG_RAD,
                solution.false_match_probability
            );
        }
    }
    tally
}

/// The same lists by another program: `None` where its answers lack the row.
fn theirs(python: &str, rows: &[(u64, Row)], trials: impl Fn(&Row) -> u64) -> Vec<Option<Tally>> {
    let folder = tempfile::tempdir().unwrap();
    let mut stars = String::from("row,trial,told_width_deg,tolerance_deg,x_px,y_px,magnitude\n");
    let mut catalog = String::from("id,ra_deg,dec_deg,magnitude\n");
    for (id, star) in Catalog::embedded().stars.iter().enumerate() {
        let (ra, dec) = star.direction.radec_rad();
        let _ = writeln!(catalog, "{id},{:.9},{:.9},{}", ra / DEG_RAD, dec / DEG_RAD, star.magnitude);
    }
    for (number, row) in rows {
        for trial in 0..trials(row) {
            let list = make(&row.scene, number << 32 | trial);
            let Some((focal_px, tolerance)) = told(row, &list, trial) else { break };
            let width_deg = 2.0 * (SIDE_PX as f64 / 2.0 / focal_px).atan() / DEG_RAD;
            for star in &list.detections.stars {
                let magnitude = -2.5 * (star.flux_dn / 1e5).log10();
                let _ = writeln!(
                    stars,
                    "{number},{trial},{width_deg:.6},{:.6},{:.6},{:.6},{magnitude:.4}",
                    width_deg * tolerance,
                    star.x_px,
                    star.y_px
                );
            }
        }
    }
    std::fs::write(folder.path().join("stars.csv"), stars).unwrap();
    std::fs::write(folder.path().join("catalog.csv"), catalog).unwrap();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("benches/peers/identify.py");
    let status = Command::new(python).arg(script).arg(folder.path()).status().expect("python starts");
    assert!(status.success(), "benches/peers/identify.py failed");
    let mut answers = csv::Reader::from_path(folder.path().join("answers.csv")).unwrap();
    let mut tallies: Vec<Option<Tally>> = rows.iter().map(|_| None).collect();
    for record in answers.records().map(Result::unwrap) {
        let number = |column: usize| record[column].parse::<f64>().unwrap();
        let place = rows.iter().position(|(row, _)| *row == number(0) as u64).unwrap();
        let (row, tally) = (&rows[place].1, tallies[place].get_or_insert_default());
        tally.ms.push(number(2));
        let solved = record[3].parse::<u8>().unwrap() == 1;
        if solved {
            let list = make(&row.scene, rows[place].0 << 32 | number(1) as u64);
            let truth = list.attitude.apparent_from_camera(&Direction::from_unit([0.0, 0.0, 1.0]));
            let middle = Direction::from_radec_rad(number(4) * DEG_RAD, number(5) * DEG_RAD);
            if !row.scene.star_free && truth.angle_rad(&middle) < RIGHT_DEG * DEG_RAD {
                tally.right += 1;
            } else {
                tally.wrong += 1;
            }
        } else {
            tally.right += usize::from(row.scene.star_free);
        }
    }
    tallies
}

fn main() {
    let arguments: Vec<String> = std::env::args().collect();
    let option = |name: &str| arguments.iter().position(|argument| argument == name).and_then(|at| arguments.get(at + 1).cloned());
    let count = |name: &str| option(name).map(|text| text.parse::<u64>().expect("a number"));
    let trials = count("--trials").unwrap_or(100);
    let star_free = count("--star-free").unwrap_or(trials);
    let trials = |row: &Row| if row.scene.star_free { star_free } else { trials };
    let only = option("--rows").unwrap_or_default();
    let rows: Vec<(u64, Row)> = (1..).zip(rows()).filter(|(_, row)| row.name.contains(&only)).collect();

    let index = Index::new(Catalog::embedded());
    let size = index.build();
    let cpuinfo = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let model = cpuinfo.lines().find_map(|line| line.strip_prefix("model name")).unwrap_or_default();
    let mut text = format!("Made by `make bench-identify` on one core of: {}\n", model.trim_start_matches([' ', '\t', ':']));
    let _ = writeln!(
        text,
        "Index: {} levels, {} triangles, {:.1} MB, built in {:.2} s (all levels, all cores)\n",
        size.levels,
        size.triangles,
        size.bytes as f64 / 1e6,
        size.build_time.as_secs_f64()
    );
    let _ = writeln!(
        text,
        "{SIDE_PX} px, 15° wide, V < 6, noise 0.1 px, magnitudes ± {MAGNITUDE_SIGMA}, false stars of magnitude 1 to 6, unless the row says otherwise; focal length\n\
         told to 10 % or, in rows of focal lengths, wrong by the factor (tolerance 7, 14, 28 %), or (no prior) not told. right: middle within\n\
         {RIGHT_DEG}°, roll, handedness and all names right; wrong: another attitude; misnamed: right but for a name. star-free: 4 to 200 points by chance;\n\
         right is a refusal. CPU time of one core.\n"
    );
    let heads = format!("{:>7} {:>6} {:>9} {:>10} {:>10} {:>10}", "right %", "wrong", "misnamed", "median ms", "95 % ms", "most ms");
    let peers = option("--python").map(|python| theirs(&python, &rows, trials));
    let peer_head = if peers.is_some() { "   tetra3rs: right %  wrong  median ms  95 % ms  ours/theirs" } else { "" };
    let _ = writeln!(text, "{:26} {:>6} {:>5} {heads}{peer_head}", "row", "lists", "stars");
    print!("{text}");
    let mut peers = peers.unwrap_or_default().into_iter();
    for (number, row) in &rows {
        let mut stars: Vec<usize> =
            (0..trials(row).min(1000)).map(|trial| make(&row.scene, number << 32 | trial).names.iter().flatten().count()).collect();
        stars.sort_unstable();
        let mut tally = ours(row, *number, trials(row), &index);
        let mut line = format!("{:26} {:6} {:5} {}", row.name, tally.ms.len(), stars[stars.len() / 2], tally.cells());
        if let Some(mut other) = peers.next().flatten() {
            let (median, late) = (other.quantile_ms(0.5), other.quantile_ms(0.95));
            let ratio = tally.quantile_ms(0.5) / median;
            let _ = write!(line, " {:19.2} {:6} {median:10.3} {late:8.2} {ratio:12.2}", other.percent(), other.wrong);
        }
        println!("{line}");
        let _ = writeln!(text, "{line}");
    }
    if let Some(page) = option("--page") {
        std::fs::write(page, text).unwrap();
    }
}
