//! Identification under stress: star lists of a camera 15° wide with every nuisance that real images bring, and lists without stars.
//!
//! `cargo bench --bench identify -- [--trials N] [--star-free N] [--rows TEXT] [--python PROGRAM] [--page FILE] [--reliability N]
//! [--reliability-page FILE]`. `--reliability N` asks how often chance does as well as is stated, on up to N lists a row, and with
//! `--trials 0` nothing else. An answer is right if the
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

use boresight::catalog::Catalog;
use boresight::coordinates::Direction;
use boresight::identify::{Identification, Index, Projection, identify, least_false_match_probability};
use boresight::units::DEG_RAD;
use rustix::time::{ClockId, clock_gettime};

#[path = "../tests/it/identify/star_lists.rs"]
#[allow(dead_code, reason = "the tests use more of it")]
mod star_lists;
use star_lists::{BASE, ByChance, List, MAGNITUDE_SIGMA, RIGHT_DEG, Scene, Told, WIDTH_PX, cpu_ms, make};

/// The other program gets no more lists of a row than these.
const MAX_OF_THEIRS: u64 = 1000;
/// So many lists are made at a time, before any of them is timed: the other program has its lists at hand too, and what makes a list leaves nothing else in the
/// processor's caches.
const MADE_TOGETHER: usize = 500;

/// A row of the table.
struct Row {
    name: &'static str,
    scene: Scene,
    told: Told,
}

impl Row {
    fn list(&self, number: u64, trial: u64) -> List {
        make(&self.scene, self.told, number << 32 | trial)
    }
}

const TEN: Told = Told::Within(0.1);
const BASE_ROW: Row = Row { name: "base", scene: BASE, told: TEN };

#[rustfmt::skip]
fn rows() -> Vec<Row> {
    let row = |name, scene, told| Row { name, scene, told };
    vec![
        BASE_ROW,
        row("noise 1 px", Scene { noise_px: 1.0, ..BASE }, TEN),
        row("noise 2 px", Scene { noise_px: 2.0, ..BASE }, TEN),
        row("radial 12.5 px", Scene { corner_px: 12.5, ..BASE }, TEN),
        row("radial 25 px", Scene { corner_px: 25.0, ..BASE }, TEN),
        row("radial 50 px", Scene { corner_px: 50.0, ..BASE }, TEN),
        row("focal length x1.05", BASE, Told::Off(1.05, 0.07)),
        row("focal length x1.10", BASE, Told::Off(1.10, 0.14)),
        row("focal length x1.20", BASE, Told::Off(1.20, 0.28)),
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
        row("no prior: base", BASE, Told::Nothing),
        row("no prior: noise 1 px", Scene { noise_px: 1.0, ..BASE }, Told::Nothing),
        row("no prior: noise 2 px", Scene { noise_px: 2.0, ..BASE }, Told::Nothing),
        row("no prior: radial 25 px", Scene { corner_px: 25.0, ..BASE }, Told::Nothing),
        row("no prior: radial 50 px", Scene { corner_px: 50.0, ..BASE }, Told::Nothing),
        row("no prior: 30 false stars", Scene { false_stars: 30, ..BASE }, Told::Nothing),
        row("no prior: 100 false stars", Scene { false_stars: 100, ..BASE }, Told::Nothing),
        row("no prior: 60 % missing", Scene { missing: 0.6, ..BASE }, Told::Nothing),
        row("no prior: mirrored", Scene { mirrored: true, ..BASE }, Told::Nothing),
        row("no prior: 5° wide, V < 8", Scene { width_deg: 5.0, faintest: 8.0, ..BASE }, Told::Nothing),
        row("no prior: 40° wide, V < 5", Scene { width_deg: 40.0, faintest: 5.0, ..BASE }, Told::Nothing),
        row("no prior: 80° wide, V < 4", Scene { width_deg: 80.0, faintest: 4.0, ..BASE }, Told::Nothing),
        row("star-free", Scene { star_free: true, ..BASE }, TEN),
        row("no prior: star-free", Scene { star_free: true, ..BASE }, Told::Nothing),
        row("no prior: fisheye 180°, V < 3.5", Scene { width_deg: 180.0, faintest: 3.5, projection: Projection::Equidistant, ..BASE }, Told::Nothing),
        row("no prior: the same, 50 false, 30 % missing", Scene { width_deg: 180.0, faintest: 3.5, projection: Projection::Equidistant, noise_px: 1.0, false_stars: 50, missing: 0.3, ..BASE }, Told::Nothing),
        row("no prior: fisheye 140°, V < 3.5", Scene { width_deg: 140.0, faintest: 3.5, projection: Projection::Equisolid, ..BASE }, Told::Nothing),
    ]
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

fn ours(row: &Row, number: u64, trials: u64, index: &Index) -> Tally {
    let mut tally = Tally::default();
    let shows = std::env::var_os("BORESIGHT_SHOW").is_some();
    let all: Vec<u64> = (0..trials).collect();
    let lists =
        all.chunks(MADE_TOGETHER).flat_map(|trials| trials.iter().map(|&trial| (trial, row.list(number, trial))).collect::<Vec<_>>());
    for (trial, list) in lists {
        let options = list.options();
        let begin = cpu_ms();
        let answer = identify(&list.detections, Catalog::embedded(), index, &[], &options);
        let ms = cpu_ms() - begin;
        tally.ms.push(ms);
        let solution = match answer {
            Identification::Identified(solution) => solution,
            Identification::NotIdentified { reason, .. } => {
                tally.right += usize::from(row.scene.star_free);
                if shows {
                    println!("  {} trial {trial}: {} stars, {ms:.1} ms; {reason}", row.name, list.names.iter().flatten().count());
                }
                continue;
            }
        };
        let (is_right, misnamed) = (list.is_right(&row.scene, &solution), list.misnamed(&solution));
        match (is_right, misnamed) {
            (true, 0) => tally.right += 1,
            (true, _) => tally.misnamed += 1,
            (false, _) => tally.wrong += 1,
        }
        if shows && (misnamed > 0 || !is_right) {
            println!(
                "  {} trial {trial}: {misnamed} of {} misnamed, {:.3}° off, P {:.1e}, rms {:.2} px",
                row.name,
                solution.matches.len(),
                list.off_rad(&solution.centre()) / DEG_RAD,
                solution.false_match_probability,
                solution.rms_px
            );
        }
    }
    tally
}

/// The same lists by another program: `None` where its answers lack the row. It names no stars, so its answer counts as right if the middle is.
fn theirs(python: &str, rows: &[(u64, Row)], trials: impl Fn(&Row) -> u64) -> Vec<Option<Tally>> {
    let folder = tempfile::tempdir().unwrap();
    let mut lists = String::from("row,trial,told_width_deg,tolerance_deg\n");
    let mut stars = String::from("row,trial,x_px,y_px,magnitude\n");
    let mut catalog = String::from("id,ra_deg,dec_deg,magnitude\n");
    for (id, star) in Catalog::embedded().stars.iter().enumerate() {
        let (ra, dec) = star.direction.radec_rad();
        let _ = writeln!(catalog, "{id},{:.9},{:.9},{}", ra / DEG_RAD, dec / DEG_RAD, star.magnitude);
    }
    for (number, row) in rows {
        for trial in 0..trials(row) {
            let list = row.list(*number, trial);
            let Some((focal_px, tolerance)) = list.prior else { break };
            let width_deg = 2.0 * (WIDTH_PX as f64 / 2.0 / focal_px).atan() / DEG_RAD;
            let _ = writeln!(lists, "{number},{trial},{width_deg:.6},{:.6}", width_deg * tolerance);
            for star in &list.detections.stars {
                let magnitude = -2.5 * (star.flux_dn / 1e5).log10();
                let _ = writeln!(stars, "{number},{trial},{:.6},{:.6},{magnitude:.4}", star.x_px, star.y_px);
            }
        }
    }
    for (name, text) in [("lists.csv", lists), ("stars.csv", stars), ("catalog.csv", catalog)] {
        std::fs::write(folder.path().join(name), text).unwrap();
    }
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
        if record[3].parse::<u8>().unwrap() == 0 {
            tally.right += usize::from(row.scene.star_free);
            continue;
        }
        let middle = Direction::from_radec_rad(number(4) * DEG_RAD, number(5) * DEG_RAD);
        let is_right = !row.scene.star_free && row.list(rows[place].0, number(1) as u64).off_rad(&middle) < RIGHT_DEG * DEG_RAD;
        tally.right += usize::from(is_right);
        tally.wrong += usize::from(!is_right);
    }
    tallies
}

/// Probabilities as they may be stated.
const STATED: [f64; 8] = [0.3, 0.1, 0.03, 0.01, 3e-3, 1e-3, 3e-4, 1e-4];

/// CPU time of all threads of this process, s.
fn processor_s() -> f64 {
    let now = clock_gettime(ClockId::ProcessCPUTime);
    now.tv_sec as f64 + 1e-9 * now.tv_nsec as f64
}

/// How often chance does as well as is stated: the page.
fn reliability(most: u64, index: &Index) -> String {
    let mut text = format!(
        "Printed by `make bench-identify IDENTIFY=\"--trials 0 --reliability {most}\"`: {}\n\n\
         Lists of which nothing can be right, and the least probability of a false match that would be stated of any hypothesis about them.\n\
         Under each probability p: how many lists have a hypothesis that is stated below it, and their share over p, with its standard\n\
         deviation; 1 is calibrated, less is cautious. A match is accepted by a bound, mostly a hundred times larger, below 1e-6.\n\n",
        boresight::provenance::made_by(None)
    );
    let heads = STATED.map(|p| format!("{p:>22}")).concat();
    let _ = writeln!(text, "{:58} {:>7}{heads}", "lists", "");
    let rows = [
        ("6 to 50 points, 4° to 60° wide, f known to 1 %", ByChance::Few, 1),
        ("4 to 200 points, 15° wide, f known to 10 %", ByChance::Points, 4),
        ("4 to 200 points, 15° wide, f not known", ByChance::PointsOfAnyField, 60),
        ("stars of the sky, V < 6.5, stretched by a third to a half", ByChance::StretchedStars, 1),
    ];
    print!("{text}");
    for (name, lists, part) in rows {
        let count = most.div_ceil(part);
        let least: Vec<f64> = (0..count)
            .filter_map(|trial| {
                let (list, options) = lists.list(1 << 40 | trial);
                least_false_match_probability(&list, Catalog::embedded(), index, &[], &options)
            })
            .collect();
        let cell = |p: &f64| {
            let found = least.iter().filter(|least| *least < p).count() as f64;
            let expected = p * least.len() as f64;
            let share = format!("{:.2} ± {:.2}", found / expected, found.max(1.0).sqrt() / expected);
            format!("{found:>8} {share:>13}")
        };
        let line = format!("{name:58} {:>7}{}", least.len(), STATED.each_ref().map(cell).concat());
        println!("{line}");
        let _ = writeln!(text, "{line}");
    }
    text
}

fn main() {
    let arguments: Vec<String> = std::env::args().collect();
    let option = |name: &str| arguments.iter().position(|argument| argument == name).and_then(|at| arguments.get(at + 1).cloned());
    let count = |name: &str| option(name).map(|text| text.parse::<u64>().expect("a number"));
    let all_trials = count("--trials").unwrap_or(100);
    let star_free = count("--star-free").unwrap_or(all_trials);
    // A refusal over all focal lengths takes ten times as long as one with a focal length.
    let trials = |row: &Row| match (row.scene.star_free, row.told) {
        (false, _) => all_trials,
        (true, Told::Nothing) => star_free.div_ceil(10),
        (true, _) => star_free,
    };
    let only = option("--rows").unwrap_or_default();
    let rows: Vec<(u64, Row)> = (1..).zip(rows()).filter(|(_, row)| row.name.contains(&only)).collect();

    let index = Index::new(Catalog::embedded());
    let ask_reliability = || {
        let Some(most) = count("--reliability") else { return };
        let page = reliability(most, &index);
        if let Some(path) = option("--reliability-page") {
            std::fs::write(path, page).unwrap();
        }
    };
    if all_trials == 0 {
        return ask_reliability();
    }
    let begin = processor_s();
    // What an index without any level builds for a frame counts in the first call.
    let (fresh, list) = (Index::new(Catalog::embedded()), BASE_ROW.list(1, 0));
    let _ = identify(&list.detections, Catalog::embedded(), &fresh, &[], &list.options());
    let first_s = processor_s() - begin;
    let begin = processor_s();
    let size = index.build();
    let build_s = processor_s() - begin;
    let cpuinfo = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let model = cpuinfo.lines().find_map(|line| line.strip_prefix("model name")).unwrap_or_default();
    let asked = if only.is_empty() { String::new() } else { format!(" --rows '{only}'") };
    let mut text = format!(
        "Printed by `make bench-identify IDENTIFY=\"--trials {all_trials} --star-free {star_free}{asked}\"`, on one core of: {}\n{}\n",
        model.trim_start_matches([' ', '\t', ':']),
        boresight::provenance::made_by(None)
    );
    let _ = writeln!(
        text,
        "Index: {} levels, {} triangles, {:.1} MB, built in {build_s:.2} s of processor time (all levels; a search builds those that it needs)\n\
         First call on the base row, with the making of the index and all that it builds: {first_s:.3} s of processor time; the rows have a built index\n",
        size.levels,
        size.triangles,
        size.bytes as f64 / 1e6
    );
    let _ = writeln!(
        text,
        "{WIDTH_PX} px, 15° wide, V < 6, noise 0.1 px, magnitudes ± {MAGNITUDE_SIGMA}, false stars of magnitude 1 to 6, unless the row says otherwise; the focal length\n\
         that is told is wrong by up to 10 % by chance (tolerance 10 %) or, in rows of focal lengths, by the factor (tolerance 7, 14, 28 %), or\n\
         (no prior) nothing is told. right: middle within {RIGHT_DEG}°, roll, handedness and all names right (of tetra3rs, which names none: the\n\
         middle); wrong: another attitude; misnamed: right but for a name. star-free: 4 to 200 points by chance; right is a refusal. CPU time of\n\
         one core; lists are made before. tetra3rs is given the first {MAX_OF_THEIRS} lists of a row.\n"
    );
    let heads = format!("{:>7} {:>6} {:>9} {:>10} {:>10} {:>10}", "right %", "wrong", "misnamed", "median ms", "95 % ms", "most ms");
    let peers = option("--python").map(|python| theirs(&python, &rows, |row| trials(row).min(MAX_OF_THEIRS)));
    let peer_head = if peers.is_some() { "   tetra3rs: right %  wrong  median ms  95 % ms  ours/theirs" } else { "" };
    let _ = writeln!(text, "{:42} {:>6} {:>5} {heads}{peer_head}", "row", "lists", "stars");
    print!("{text}");
    let mut peers = peers.unwrap_or_default().into_iter();
    for (number, row) in &rows {
        let mut stars: Vec<usize> =
            (0..trials(row).min(1000)).map(|trial| row.list(*number, trial).names.iter().flatten().count()).collect();
        stars.sort_unstable();
        let mut tally = ours(row, *number, trials(row), &index);
        let mut line = format!("{:42} {:6} {:5} {}", row.name, tally.ms.len(), stars[stars.len() / 2], tally.cells());
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
    ask_reliability();
}
