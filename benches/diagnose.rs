//! How the time of a diagnosis grows: with simulations, with frames, with what is found. One core; each case takes its turn in every round,
//! and its time over that of the first case in the same round is told, so that a machine that slows down does not enter.
#![allow(missing_docs, reason = "a bench is no interface")]
#![allow(clippy::unwrap_used, reason = "a bench that meets the unexpected must fail")]
#![allow(clippy::print_stdout, reason = "its table is what a bench is for")]

use std::time::Instant;

use boresight::calibrate::trial::Trial;
use boresight::catalog::Catalog;
use boresight::diagnose::{DiagnoseOptions, diagnose};
use boresight::effects::StarState;
use boresight::identify::ControlPoints;

const ROUNDS: usize = 5;
/// A focal length that colour changes; and a shear of the frame.
const COLOUR: f64 = 4e-4;
const SHEAR: f64 = 2e-4;

/// Frames of the published camera, with the first `effects` of the two displacements.
fn night(frames: usize, effects: usize) -> ControlPoints {
    let trial = Trial { frames, ..Trial::published() };
    let mut points = trial.night(Catalog::embedded(), 1).control_points;
    for point in &mut points.points {
        let colour = point.colour.map_or(0.0, |colour| colour - StarState::REFERENCE_COLOUR);
        let [x, y] = [point.x_px - 511.5, point.y_px - 511.5];
        if effects > 0 {
            point.x_px += COLOUR * colour * x;
            point.y_px += COLOUR * colour * y;
        }
        if effects > 1 {
            point.x_px += SHEAR * y;
        }
    }
    points
}

fn main() {
    // Frames, effects, simulations; the first is what the others are compared with.
    let cases = [(40, 0, 1000), (40, 0, 100), (40, 0, 4000), (16, 0, 1000), (100, 0, 1000), (40, 1, 1000), (40, 2, 1000)];
    let nights = cases.map(|(frames, effects, _)| night(frames, effects));
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let mut seconds = [const { Vec::new() }; 7];
    let mut ratios = [const { Vec::new() }; 7];
    let mut found = [0; 7];
    for _ in 0..ROUNDS {
        for (case, points) in nights.iter().enumerate() {
            let options = DiagnoseOptions { nulls: cases[case].2, ..DiagnoseOptions::default() };
            let begin = Instant::now();
            let diagnosis = pool.install(|| diagnose(points, &Vec::new(), &options)).unwrap();
            seconds[case].push(begin.elapsed().as_secs_f64());
            found[case] = diagnosis.findings.len();
            let of_first: f64 = *seconds[0].last().unwrap();
            ratios[case].push(seconds[case].last().unwrap() / of_first);
        }
    }
    let median = |values: &[f64]| {
        let mut sorted = values.to_vec();
        sorted.sort_by(f64::total_cmp);
        sorted[sorted.len() / 2]
    };
    println!("frames  images  effects  found  simulations  median s  of the first");
    for (case, (frames, effects, nulls)) in cases.into_iter().enumerate() {
        println!(
            "{frames:6}  {:6}  {effects:7}  {:5}  {nulls:11}  {:8.3}  {:12.2}",
            nights[case].points.len(),
            found[case],
            median(&seconds[case]),
            median(&ratios[case])
        );
    }
}
