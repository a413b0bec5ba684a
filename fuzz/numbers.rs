//! Other numbers in good scenes, by a seed: what passes many checks of range and may make a frame that nobody waits for.

use super::damage::Chance;
use super::zoo::File;

/// What is written in the place of a scene's numbers: such as pass many checks of range.
const LARGE_AND_SMALL: [&str; 20] = [
    "0.0", "-1.0", "1e-300", "1e-9", "1e-4", "0.01", "0.5", "2", "7", "30.0", "1e2", "1e3", "1e4", "1e5", "1e6", "1e7", "1e9", "1e12",
    "1e15", "1e300",
];

/// A good scene with one to three numbers replaced.
pub(crate) fn other_numbers(seeds: &[File], chance: &mut Chance) -> File {
    let (name, mut bytes) = seeds[chance.below(seeds.len())].clone();
    for _ in 0..=chance.below(3) {
        let starts: Vec<usize> = (1..bytes.len()).filter(|at| bytes[*at].is_ascii_digit() && b" [-".contains(&bytes[*at - 1])).collect();
        let start = starts[chance.below(starts.len())];
        let length = bytes[start..].iter().take_while(|byte| byte.is_ascii_digit() || b".e-+".contains(byte)).count();
        bytes.splice(start..start + length, LARGE_AND_SMALL[chance.below(LARGE_AND_SMALL.len())].bytes());
    }
    (name, bytes)
}
