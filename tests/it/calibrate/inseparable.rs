//! Parameters that the star images cannot tell apart: whatever is solved stays within its standard errors of the truth, however little the
//! linearisation at the solution knows of the open direction, and it is said by name.

use boresight::calibrate::calibrate;
use boresight::camera::Model;
use boresight::effects::displacement;
use rayon::prelude::*;

use super::effects::{SkyNight, camera, largest_pull, solving};

const SEEDS: u64 = 12;

/// What is solved beside f, x0, y0 and k1; effects in force, and at how many times their typical size.
fn solve_many(effects: &[&str], times_typical: f64, with: &[&str]) -> Vec<(f64, Vec<String>)> {
    let names: Vec<&str> = effects.iter().chain(with).copied().collect();
    let mut truth = Model::new(camera());
    for id in effects {
        let parameters = displacement(id).unwrap().parameters();
        let values: Vec<f64> = parameters.iter().map(|spec| (times_typical * spec.typical).clamp(spec.range.0, spec.range.1)).collect();
        truth.set(id, &values).unwrap();
    }
    let solved = (1..=SEEDS).into_par_iter().filter_map(|seed| {
        let (points, _) = SkyNight::new(truth.clone()).observe(seed);
        match calibrate(&points, &solving(&names)) {
            Ok(result) => {
                let (pull, name) = largest_pull(&result, &truth);
                if pull > 5.0 {
                    println!(
                        "{names:?} × {times_typical}, seed {seed}: {name} is off by {pull:.1} σ: {:?} {:?}",
                        result.parameters, result.warnings
                    );
                }
                Some((pull, result.warnings))
            }
            Err(error) => {
                let sentence = error.to_string();
                println!("{names:?} × {times_typical}, seed {seed}: {sentence}");
                assert!(effects.iter().any(|id| sentence.contains(id)), "{sentence}");
                None
            }
        }
    });
    let solved: Vec<_> = solved.collect();
    let largest = solved.iter().map(|(pull, _)| *pull).fold(0.0, f64::max);
    let wider = solved.iter().filter(|(_, warnings)| warnings.iter().any(|warning| warning.contains("is hardly determined"))).count();
    println!("{names:?} × {times_typical}: {} of {SEEDS} solved, {wider} with wider errors, largest pull {largest:.2}", solved.len());
    solved
}

#[test]
fn what_is_solved_stays_within_its_errors() {
    for (effects, times_typical, with) in [
        (&["detector-tilt"][..], 1.0, &["p1", "p2"][..]),
        (&["detector-tilt"], 10.0, &["p1", "p2"]),
        (&["detector-tilt"], 1.0, &[]),
        (&["thin-prism"], 1.0, &["p1", "p2"]),
        (&["thin-prism"], 10.0, &["p1", "p2"]),
        (&["thin-prism", "detector-tilt"], 1.0, &["p1", "p2"]),
        (&["projection", "radial-high-order"], 1.0, &[]),
    ] {
        let solved = solve_many(effects, times_typical, with);
        // A refusal by name is an answer too; refusing everything would be none. Prism and tilt together with p1 and p2 are six parameters
        // for two patterns: there a refusal is right.
        let is_too_much = effects.len() > 1 && with.len() > 1;
        assert!(is_too_much || 2 * solved.len() > SEEDS as usize, "{effects:?}: {} solved", solved.len());
        for (pull, warnings) in solved {
            assert!(pull <= 5.0, "{effects:?} × {times_typical} with {with:?}: {pull} σ");
            let said = |warning: &String| warning.contains("cannot be told apart") && effects.iter().any(|id| warning.contains(id));
            assert!(warnings.iter().any(said), "{effects:?}: {warnings:?}");
        }
    }
}

/// What is merely weak is solved, with the errors that the linearisation gives: they are right there.
#[test]
fn what_is_merely_weak_is_solved_as_before() {
    let solved = solve_many(&[], 1.0, &["p1", "p2"]);
    assert_eq!(solved.len(), SEEDS as usize);
    for (pull, warnings) in solved {
        assert!(pull <= 5.0, "{pull}");
        assert!(!warnings.iter().any(|warning| warning.contains("is hardly determined")), "{warnings:?}");
    }
}
