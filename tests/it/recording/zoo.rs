//! The zoo of files and a short run of the fuzzer; `make fuzz` makes the long one.

#[path = "../../../fuzz/damage.rs"]
mod damage;
#[path = "../../../fuzz/readers.rs"]
mod readers;
#[path = "../../../fuzz/zoo.rs"]
#[allow(clippy::module_inception, reason = "the zoo of the zoo's test")]
mod zoo;

use std::panic::{AssertUnwindSafe, catch_unwind};

use damage::{Chance, damaged};
use readers::Reader;

/// Words of the libraries beneath, which tell a user nothing.
const NOT_OURS: [&str; 7] = ["Unknown(", "ChunkType", "Integer(", "Utf8Error", "ParseIntError", "Some(", "Memory limit"];

#[test]
fn every_file_of_the_zoo_is_read_or_refused_in_our_words() {
    let folder = tempfile::tempdir().unwrap();
    let files = zoo::zoo();
    assert!(files.len() >= 70, "{}", files.len());
    let found: Vec<String> = files.iter().map(|file| zoo::line(folder.path(), file)).collect();
    let kept = include_str!("../../../fuzz/zoo.txt");
    let differ: Vec<String> = found
        .iter()
        .filter(|line| !kept.lines().any(|kept| kept == **line))
        .map(|line| {
            let name = line.split(':').next().unwrap_or("");
            let before = kept.lines().find(|kept| kept.split(':').next() == Some(name)).unwrap_or("(absent)");
            format!("now  {line}\nkept {before}")
        })
        .collect();
    assert!(differ.is_empty(), "where that is meant, write the table anew with `make zoo`:\n{}", differ.join("\n"));
    assert_eq!(kept.lines().count(), found.len(), "the table has lines of files that are not there");
    for line in &found {
        assert!(line.contains(": read: ") || line.contains(": refused: "), "{line}");
        assert!(NOT_OURS.iter().all(|words| !line.contains(words)), "{line}");
    }
}

#[test]
fn damaged_inputs_are_values_for_every_reader() {
    const CASES: u64 = 60;
    for reader in Reader::ALL {
        let seeds = reader.seeds();
        let folder = tempfile::tempdir().unwrap();
        let mut outcomes = [0; 2];
        for (name, bytes) in &seeds {
            let given = catch_unwind(AssertUnwindSafe(|| reader.read(folder.path(), &(name.clone(), bytes.clone()))));
            assert!(given.is_ok(), "{}: {name}", reader.name());
        }
        for case in 0..CASES {
            let input = damaged(&seeds, &mut Chance::new(1000 * case + 7));
            let outcome = catch_unwind(AssertUnwindSafe(|| reader.read(folder.path(), &input)));
            let outcome = outcome.unwrap_or_else(|_| panic!("{}, case {case}: a panic", reader.name()));
            if let Err(sentence) = &outcome {
                assert!(!sentence.contains('\n') && !sentence.trim().is_empty(), "{}, case {case}: {sentence:?}", reader.name());
                assert!(NOT_OURS.iter().all(|words| !sentence.contains(words)), "{}, case {case}: {sentence}", reader.name());
                assert!(!sentence.starts_with("FAULT"), "{}, case {case}: {sentence}", reader.name());
            }
            outcomes[usize::from(outcome.is_err())] += 1;
        }
        assert!(outcomes[1] > 0, "{}: nothing was refused, so nothing was damaged", reader.name());
    }
}
