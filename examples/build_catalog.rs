//! Packs `catalogs/hipparcos.bin` and `catalogs/names.csv` from the two packages that they come from:
//! the crate `star-catalog` 0.2.0 and the Python package `ruststartracker` 0.2.10.
//!
//! ```text
//! cargo run --example build_catalog -- path/to/ruststartracker/hipparcos_data_j1991.25.csv [folder]
//! ```
//! Prints what it found, joined and changed; the same sources give the same bytes.
#![allow(clippy::print_stdout, reason = "a command")]

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use boresight::catalog::{Catalog, Star};
use boresight::coordinates::Direction;
use boresight::units::{ARCSEC_RAD, DEG_RAD, MAS_RAD};
use sha2::{Digest, Sha256};

const EPOCH_YR: f64 = 1991.25;
/// SHA-256 of the table in `ruststartracker` 0.2.10.
const NEWER_SHA256: &str = "0c5840db27dd2f3bdbe4828a0caded935047e2e5a487de873a61aad529cfefce";
/// `star-catalog` computes a distance in light years as this over the parallax in mas.
const LIGHT_YEARS_MAS: f64 = 3.26156e3;
/// Above this, the two solutions of a star disagree (one star in two hundred), and it is marked.
const DOUBT_MAS: f64 = 10.0;
/// The list of names in `star-catalog` gives α Centauri A the number of B.
const NAME_CORRECTIONS: [(&str, u32); 1] = [("Rigil Kentaurus", 71_683)];

/// A row of the newer reduction (van Leeuwen 2007).
#[derive(serde::Deserialize)]
struct Newer {
    source_id: u32,
    ra: f64,
    dec: f64,
    parallax: f64,
    pmra: f64,
    pmdec: f64,
    /// In truth Hp, the magnitude in the satellite's own band.
    phot_g_mean_mag: f64,
}

impl Newer {
    fn direction(&self) -> Direction<boresight::coordinates::Icrs> {
        Direction::from_radec_rad(self.ra * DEG_RAD, self.dec * DEG_RAD)
    }
}

/// How the two reductions differ for a star in both.
struct Difference {
    hip: u32,
    separation_mas: f64,
    offset_mas: [f64; 2],
    motion_mas_yr: [f64; 2],
    parallax_mas: f64,
    v_minus_hp: f64,
    magnitude: f64,
}

fn main() -> Result<()> {
    let mut arguments = std::env::args_os().skip(1).map(PathBuf::from);
    let newer_path = arguments.next().context("usage: build_catalog hipparcos_data_j1991.25.csv [folder]")?;
    let folder = arguments.next().unwrap_or_else(|| PathBuf::from("catalogs"));

    let mut stars = read_first_reduction()?;
    let newer = read_newer_reduction(&newer_path)?;
    println!("first reduction (star-catalog): {} stars", stars.len());
    println!("newer reduction (ruststartracker): {} stars", newer.len());

    let differences = compare(&stars, &newer);
    report_agreement(&differences)?;
    let doubtful = join(&mut stars, &newer, &differences)?;
    report_motions(&differences);

    let with_motion = stars.values().filter(|star| star.proper_motion_rad_yr.is_some()).count();
    println!("packed: {} stars, {with_motion} with proper motion, {} marked doubtful", stars.len(), doubtful.len());
    let names = names(&stars)?;
    println!("names: {}", names.len());
    write(&folder, stars, doubtful, &names)
}

/// Positions, V, B − V and parallax of all stars to V ≈ 8, by Hipparcos number.
fn read_first_reduction() -> Result<BTreeMap<u32, Star>> {
    let package = star_catalog::Catalog::load_catalog("hipp_bright", f32::INFINITY).map_err(|error| anyhow::anyhow!("{error:?}"))?;
    let mut stars = BTreeMap::new();
    let (mut unmeasured, mut negative) = (0, 0);
    for star in package.iter_stars() {
        let hip = u32::try_from(star.id())?;
        // distance 0 stands for a parallax of 0
        let parallax_mas = if star.distance() == 0.0 { 0.0 } else { LIGHT_YEARS_MAS / f64::from(star.distance()) };
        unmeasured += usize::from(parallax_mas == 0.0);
        negative += usize::from(parallax_mas < 0.0);
        let entry = Star {
            hip,
            direction: Direction::from_radec_rad(star.ra(), star.de()),
            proper_motion_rad_yr: None,
            parallax_rad: parallax_mas.max(0.0) * MAS_RAD,
            // printed to 0.01 mag; as f32 it would not sort together with the same value from elsewhere
            magnitude: (f64::from(star.magnitude()) * 100.0).round() / 100.0,
            colour: Some(f64::from(star.bv())),
        };
        ensure!(stars.insert(hip, entry).is_none(), "HIP {hip} twice in star-catalog");
    }
    println!("first reduction: {unmeasured} parallaxes of 0, {negative} negative ones (both packed as 0)");
    Ok(stars)
}

fn read_newer_reduction(path: &Path) -> Result<BTreeMap<u32, Newer>> {
    let bytes = std::fs::read(path).with_context(|| format!("reading {}", path.display()))?;
    let found = format!("{:x}", Sha256::digest(&bytes));
    ensure!(found == NEWER_SHA256, "{} has the SHA-256 {found}, not {NEWER_SHA256}; take it from ruststartracker 0.2.10", path.display());
    let mut rows = BTreeMap::new();
    for row in csv::Reader::from_reader(bytes.as_slice()).deserialize() {
        let row: Newer = row?;
        let hip = row.source_id;
        ensure!(rows.insert(hip, row).is_none(), "HIP {hip} twice in {}", path.display());
    }
    Ok(rows)
}

fn compare(stars: &BTreeMap<u32, Star>, newer: &BTreeMap<u32, Newer>) -> Vec<Difference> {
    let both = newer.iter().filter_map(|(hip, row)| stars.get(hip).map(|star| (*hip, star, row)));
    both.map(|(hip, star, row)| {
        let (ra_rad, dec_rad) = star.direction.radec_rad();
        let turn = std::f64::consts::TAU;
        let east_rad = (ra_rad - row.ra * DEG_RAD + 0.5 * turn).rem_euclid(turn) - 0.5 * turn;
        Difference {
            hip,
            separation_mas: star.direction.angle_rad(&row.direction()) / MAS_RAD,
            offset_mas: [east_rad * dec_rad.cos() / MAS_RAD, (dec_rad - row.dec * DEG_RAD) / MAS_RAD],
            motion_mas_yr: [row.pmra, row.pmdec],
            parallax_mas: star.parallax_rad / MAS_RAD - row.parallax.max(0.0),
            v_minus_hp: star.magnitude - row.phot_g_mean_mag,
            magnitude: star.magnitude,
        }
    })
    .collect()
}

/// Shows that both give ICRS positions at the same epoch: any difference of epochs would show along the proper motions.
fn report_agreement(differences: &[Difference]) -> Result<()> {
    let separations: Vec<f64> = differences.iter().map(|d| d.separation_mas).collect();
    let [half, p95, p99] = [0.5, 0.95, 0.99].map(|share| quantile(&separations, share));
    println!(
        "in both: {} stars; separation median {half:.2} mas, 95 % {p95:.2}, 99 % {p99:.2}, largest {:.1}",
        differences.len(),
        quantile(&separations, 1.0)
    );
    let agreeing = || differences.iter().filter(|d| d.separation_mas < DOUBT_MAS);
    let along: f64 = agreeing().map(|d| d.offset_mas[0] * d.motion_mas_yr[0] + d.offset_mas[1] * d.motion_mas_yr[1]).sum();
    let square: f64 = agreeing().map(|d| d.motion_mas_yr[0].powi(2) + d.motion_mas_yr[1].powi(2)).sum();
    let epoch_difference_yr = along / square;
    println!("in both: difference of epochs, fitted along the proper motions: {epoch_difference_yr:.5} yr");
    ensure!(epoch_difference_yr.abs() < 1e-3 && half < 1.0, "the two packages do not give positions at the same epoch");
    for (axis, name) in ["right ascension (times cos of declination)", "declination"].into_iter().enumerate() {
        let offsets: Vec<f64> = differences.iter().map(|d| d.offset_mas[axis]).collect();
        println!("in both: median difference in {name}: {:.3} mas", quantile(&offsets, 0.5));
    }
    let parallaxes: Vec<f64> = differences.iter().map(|d| d.parallax_mas.abs()).collect();
    println!("in both: parallaxes differ by {:.2} mas (median), {:.2} (99 %)", quantile(&parallaxes, 0.5), quantile(&parallaxes, 0.99));
    Ok(())
}

/// Takes position, parallax and proper motion from the newer reduction; returns the doubtful stars.
fn join(stars: &mut BTreeMap<u32, Star>, newer: &BTreeMap<u32, Newer>, differences: &[Difference]) -> Result<Vec<(u32, f64)>> {
    let v_minus_hp = quantile(&differences.iter().map(|d| d.v_minus_hp).collect::<Vec<_>>(), 0.5);
    println!("in both: median V - Hp = {v_minus_hp:.3} mag");
    let by_hip: BTreeMap<u32, &Difference> = differences.iter().map(|d| (d.hip, d)).collect();
    let (mut doubtful, mut added, mut negative) = (Vec::new(), Vec::new(), 0);
    for (&hip, row) in newer {
        // a parallax far below zero is no measurement of a distance, but a solution gone wrong
        let below_zero_mas = row.parallax.min(0.0);
        negative += usize::from(row.parallax < 0.0);
        let disagreement_mas = by_hip.get(&hip).map_or(0.0, |d| d.separation_mas.hypot(d.parallax_mas)).hypot(below_zero_mas);
        if disagreement_mas > DOUBT_MAS {
            doubtful.push((hip, disagreement_mas.ceil() / std::f64::consts::SQRT_2 * MAS_RAD));
        }
        let star = stars.entry(hip).or_insert_with(|| {
            added.push(hip);
            // the first reduction has no B − V for these, so star-catalog left them out
            let magnitude = ((row.phot_g_mean_mag + v_minus_hp) * 100.0).round() / 100.0;
            Star { hip, direction: row.direction(), proper_motion_rad_yr: None, parallax_rad: 0.0, magnitude, colour: None }
        });
        star.direction = row.direction();
        star.parallax_rad = row.parallax.max(0.0) * MAS_RAD;
        star.proper_motion_rad_yr = Some([row.pmra * MAS_RAD, row.pmdec * MAS_RAD]);
    }
    println!("newer reduction: {negative} negative parallaxes (packed as 0)");
    println!("only in the newer reduction: {} stars, V taken as Hp + ({v_minus_hp:.3}), no colour: HIP {added:?}", added.len());
    let Some(largest) = doubtful.iter().map(|&(_, per_axis_rad)| per_axis_rad).reduce(f64::max) else {
        bail!("no star is doubtful, which cannot be");
    };
    println!("doubtful: solutions more than {DOUBT_MAS} mas apart; largest {:.0} mas", largest / MAS_RAD * std::f64::consts::SQRT_2);
    Ok(doubtful)
}

/// The proper motions of stars by magnitude, and the law that stands in `src/catalog/position_error.rs`.
fn report_motions(differences: &[Difference]) {
    let totals: Vec<f64> = differences.iter().map(|d| d.motion_mas_yr[0].hypot(d.motion_mas_yr[1])).collect();
    println!(
        "proper motions: median {:.1} mas/yr, 99 % {:.0}, largest {:.0}",
        quantile(&totals, 0.5),
        quantile(&totals, 0.99),
        quantile(&totals, 1.0)
    );
    let mut sums = [0.0; 5];
    for step in 0..9 {
        let [low, high] = [step, step + 1].map(|edge| f64::from(400 + 30 * edge) / 100.0);
        let inside: Vec<&Difference> = differences.iter().filter(|d| (low..high).contains(&d.magnitude)).collect();
        let components: Vec<f64> = inside.iter().flat_map(|d| d.motion_mas_yr).map(f64::abs).collect();
        let count = inside.len() as f64;
        let x = inside.iter().map(|d| d.magnitude).sum::<f64>() / count - 6.5;
        let sigma = quantile(&components, 0.6827);
        let rms = (components.iter().map(|c| c * c).sum::<f64>() / components.len() as f64).sqrt();
        println!(
            "proper motions: V {low:.1}-{high:.1}: {count:5} stars, 68.27 % of |component| below {sigma:5.1} mas/yr, 99 % {:.0}, rms {rms:.0}",
            quantile(&components, 0.99)
        );
        for (sum, term) in sums.iter_mut().zip([count, count * x, count * x * x, count * sigma.ln(), count * x * sigma.ln()]) {
            *sum += term;
        }
    }
    let [n, sx, sxx, sy, sxy] = sums;
    let slope = (n * sxy - sx * sy) / (n * sxx - sx * sx);
    println!("proper motions: sigma = {:.2} mas/yr at V 6.5, times exp({slope:.4} (V - 6.5))", ((sy - slope * sx) / n).exp());
}

/// Names by number: those approved by the IAU, then others in use; each checked against the star's position.
fn names(stars: &BTreeMap<u32, Star>) -> Result<BTreeMap<u32, &'static str>> {
    let mut names = BTreeMap::new();
    let mut absent = BTreeSet::new();
    for &(name, hip, ra_deg, dec_deg) in star_catalog::iau::NAMES_AND_RA_DE {
        let Some(hip) = hip else { continue };
        let corrected = NAME_CORRECTIONS.iter().find(|&&(wrong, _)| wrong == name).map(|&(_, right)| right);
        let hip = corrected.map_or_else(|| u32::try_from(hip), Ok)?;
        let Some(star) = stars.get(&hip) else {
            absent.insert(hip);
            continue;
        };
        let off_arcsec = star.direction.angle_rad(&Direction::from_radec_rad(ra_deg * DEG_RAD, dec_deg * DEG_RAD)) / ARCSEC_RAD;
        ensure!(off_arcsec < 60.0, "{name} is {off_arcsec:.0} arcsec from HIP {hip}");
        if let Some(other) = names.insert(hip, name) {
            bail!("HIP {hip} is called both {other} and {name}");
        }
    }
    for &(hip, name) in star_catalog::hipparcos::HIP_ALIASES {
        let hip = u32::try_from(hip)?;
        if stars.contains_key(&hip) {
            names.entry(hip).or_insert(name);
        }
    }
    println!("names: {} of the IAU's are of fainter stars and left out", absent.len());
    Ok(names)
}

fn write(folder: &Path, stars: BTreeMap<u32, Star>, doubtful: Vec<(u32, f64)>, names: &BTreeMap<u32, &str>) -> Result<()> {
    let source = "Hipparcos to V 8 (ESA 1997; proper motion and parallax of the brighter ones: van Leeuwen 2007)";
    let catalog = Catalog::new(stars.into_values().collect(), EPOCH_YR, source.into(), String::new()).with_doubtful(doubtful);
    let bytes = catalog.to_bytes()?;
    let mut table = "hip,name\n".to_owned();
    for (hip, name) in names {
        table.extend([&hip.to_string(), ",", name, "\n"]);
    }
    std::fs::create_dir_all(folder)?;
    let hash = |bytes: &[u8]| format!("{:x}", Sha256::digest(bytes));
    std::fs::write(folder.join("hipparcos.bin"), &bytes)?;
    std::fs::write(folder.join("names.csv"), &table)?;
    let hashes = format!("{}  hipparcos.bin\n{}  names.csv\n", hash(&bytes), hash(table.as_bytes()));
    std::fs::write(folder.join("SHA256SUMS"), &hashes)?;
    println!("{hashes}{} and {} bytes written to {}", bytes.len(), table.len(), folder.display());
    Ok(())
}

/// The value below which `share` of the values lie.
fn quantile(values: &[f64], share: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let place = (share * sorted.len() as f64) as usize;
    sorted.get(place.min(sorted.len().saturating_sub(1))).copied().unwrap_or(f64::NAN)
}
