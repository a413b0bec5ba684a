//! Makes `catalogs/constellations.csv` from the files of the npm package d3-celestial: `make catalog` runs it.
//!
//! Lines there join places of stars; here they join Hipparcos numbers, so that they move with the stars and are lit where these are.
#![allow(clippy::print_stdout, reason = "an example that says what it did")]
#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a build step that meets the unexpected must fail")]

use std::collections::BTreeMap;

use boresight::catalog::Catalog;
use boresight::coordinates::{Direction, Icrs};
use boresight::units::{ARCSEC_RAD, DEG_RAD};
use serde_json::Value;

/// A place is a star's if one of the catalogue lies as near; of several the brightest, since lines join bright stars.
const NEAR_RAD: f64 = 0.05 * DEG_RAD;

fn main() {
    let mut arguments = std::env::args().skip(1);
    let mut read = || -> Value {
        let path = arguments.next().expect("usage: build_constellations LINES.json CONSTELLATIONS.json");
        serde_json::from_str(&std::fs::read_to_string(&path).unwrap()).unwrap()
    };
    let (lines, names) = (read(), read());
    let features = |value: &Value| value["features"].as_array().unwrap().clone();
    let names: BTreeMap<String, String> = features(&names).iter().map(|one| (text(&one["id"]), text(&one["properties"]["la"]))).collect();
    let catalog = Catalog::embedded();
    let (mut farthest_rad, mut without, mut rows) = (0.0_f64, 0, Vec::new());
    let mut star_at = |place: &Value| -> Option<u32> {
        let [ra, dec] = [0, 1].map(|axis| place[axis].as_f64().unwrap() * DEG_RAD);
        let direction = Direction::<Icrs>::from_radec_rad(ra, dec);
        let apart = |star: &boresight::catalog::Star| star.direction.angle_rad(&direction);
        // The stars are in order of brightness.
        let star = catalog.stars.iter().find(|star| apart(star) < NEAR_RAD)?;
        farthest_rad = farthest_rad.max(apart(star));
        Some(star.hip)
    };
    for one in features(&lines) {
        let id = text(&one["id"]);
        for line in one["geometry"]["coordinates"].as_array().unwrap() {
            let stars: Vec<Option<u32>> = line.as_array().unwrap().iter().map(&mut star_at).collect();
            for pair in stars.windows(2) {
                match pair {
                    [Some(from), Some(to)] if from != to => rows.push(format!("{id},{},{from},{to}\n", names[&id])),
                    _ => without += 1,
                }
            }
        }
    }
    rows.sort();
    rows.dedup();
    let table = "constellation,name,from_hip,to_hip\n".to_owned() + &rows.concat();
    boresight::recording::write_file(std::path::Path::new("catalogs/constellations.csv"), table.as_bytes()).unwrap();
    println!(
        "constellations: {} lines; places within {:.0} arcsec of their stars; {without} lines without a star",
        rows.len(),
        farthest_rad / ARCSEC_RAD
    );
}

/// Words; some of the names have a narrow space between them, for which few fonts have a letter.
fn text(value: &Value) -> String {
    value.as_str().unwrap().replace(char::is_whitespace, " ")
}
