//! What several tests share.

use std::fs::OpenOptions;
use std::io::Write;
use std::path::PathBuf;

/// The folder of real recordings from BORESIGHT_RECORDINGS; `None`, reported by name, where the variable is not set.
///
/// With BORESIGHT_TEST_LOG=FILE a line `recording-test NAME ran|skipped` is added to that file.
///
/// # Panics
/// If the variable names no folder: a test that was asked for must not be left out unseen.
pub(crate) fn recordings_dir(test: &str) -> Option<PathBuf> {
    let directory = std::env::var_os("BORESIGHT_RECORDINGS").filter(|value| !value.is_empty()).map(PathBuf::from);
    if let Some(directory) = &directory {
        assert!(directory.is_dir(), "BORESIGHT_RECORDINGS names {}, which is no folder", directory.display());
    } else {
        println!("skipped: {test} (BORESIGHT_RECORDINGS is not set)");
    }
    log(&format!("recording-test {test} {}", if directory.is_some() { "ran" } else { "skipped" }));
    directory
}

/// Adds a line to the file that BORESIGHT_TEST_LOG names, if it names one.
pub(crate) fn log(line: &str) {
    let Some(path) = std::env::var_os("BORESIGHT_TEST_LOG").filter(|value| !value.is_empty()) else {
        return;
    };
    let mut file = OpenOptions::new().create(true).append(true).open(&path).expect("BORESIGHT_TEST_LOG names a file that can be written");
    file.write_all(format!("{line}\n").as_bytes()).expect("BORESIGHT_TEST_LOG can be written");
}

/// Says that a test ran on the GPU: call it after the work on the adapter is done.
#[allow(dead_code, reason = "called by the tests of the renderer")]
pub(crate) fn log_gpu_test(test: &str, adapter: &str) {
    log(&format!("gpu-test {test} {adapter}"));
}

/// What proptest found once it tries first ever after: the cases stand beside the test, in FILE.regressions.
pub(crate) fn regressions() -> Box<dyn proptest::test_runner::FailurePersistence> {
    Box::new(proptest::test_runner::FileFailurePersistence::WithSource("regressions"))
}

/// What is wrong with the page of an effect: headings that lack or stand out of order, sections without text, sources without a year.
fn page_faults(page: &str) -> Vec<String> {
    use boresight::effects::PAGE_HEADINGS;
    let mut sections = page.split("\n## ").map(|section| section.split_once('\n').unwrap_or((section, "")));
    let mut faults = Vec::new();
    if sections.next().is_none_or(|(title, _)| !title.starts_with("# ")) {
        faults.push("it begins without its title".to_owned());
    }
    let sections: Vec<(&str, &str)> = sections.collect();
    let headings: Vec<&str> = sections.iter().map(|(heading, _)| *heading).collect();
    if headings != PAGE_HEADINGS {
        faults.push(format!("its headings are {headings:?} instead of {PAGE_HEADINGS:?}"));
    }
    for (heading, text) in &sections {
        if text.lines().all(|line| line.trim().is_empty() || line.starts_with('#')) {
            faults.push(format!("nothing stands below {heading}"));
        }
    }
    let is_year = |word: &str| matches!(word.parse::<u32>(), Ok(1600..=2100)) && word.len() == 4;
    let is_cited = |text: &str| text.split(|letter: char| !letter.is_ascii_digit()).any(is_year);
    if !sections.iter().any(|(heading, text)| *heading == "Source" && is_cited(text)) {
        faults.push("its source cites nothing that has a year".to_owned());
    }
    faults
}

/// # Panics
/// If the page of this effect is not complete.
pub(crate) fn check_page(id: &str, page: &str) {
    let faults = page_faults(page);
    assert!(faults.is_empty(), "the page of {id}: {}", faults.join("; "));
}

/// Each fault is found, one at a time, in a page that has none.
#[test]
fn a_page_that_is_not_complete_is_refused() {
    let headings = boresight::effects::PAGE_HEADINGS;
    let whole = headings.iter().fold("# Title\n".to_owned(), |page, heading| page + &format!("\n## {heading}\n\nBrown (1966).\n"));
    assert_eq!(page_faults(&whole), [""; 0]);
    for heading in headings {
        let lacks = whole.replace(&format!("\n## {heading}\n\nBrown (1966).\n"), "");
        assert!(page_faults(&lacks)[0].starts_with("its headings are"), "{heading}");
        let is_empty = whole.replace(&format!("## {heading}\n\nBrown (1966)."), &format!("## {heading}\n\n### Below"));
        assert_eq!(page_faults(&is_empty)[0], format!("nothing stands below {heading}"));
    }
    let swapped = whole.replace("## Neglected", "## ?").replace("## Signature", "## Neglected").replace("## ?", "## Signature");
    assert!(page_faults(&swapped)[0].starts_with("its headings are"));
    let without_year = whole.rsplit_once("(1966)").map(|(before, _)| before.to_owned()).unwrap();
    assert_eq!(page_faults(&without_year), ["its source cites nothing that has a year"]);
    assert_eq!(page_faults(whole.trim_start_matches("# Title")), ["it begins without its title"]);
}
