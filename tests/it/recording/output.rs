//! Output is there whole or not at all.

use std::fs;

use boresight::recording::{OutputDirectory, write_file};

fn names(folder: &std::path::Path) -> Vec<String> {
    let mut names: Vec<String> = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[test]
fn files_are_replaced_whole() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("new/result.json");
    write_file(&path, b"one").unwrap();
    write_file(&path, b"two").unwrap();
    assert_eq!(fs::read(&path).unwrap(), b"two");
    assert_eq!(names(path.parent().unwrap()), ["result.json"]);
    // where a folder stands, nothing is left behind
    fs::create_dir_all(folder.path().join("taken/within")).unwrap();
    let sentence = write_file(&folder.path().join("taken"), b"three").unwrap_err().to_string();
    assert!(sentence.contains("taken: cannot be written"), "{sentence}");
    assert_eq!(names(folder.path()), ["new", "taken"]);
}

#[cfg(unix)]
#[test]
fn what_is_written_can_be_read_by_those_whom_the_user_lets() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir().unwrap();
    let mode = |name: &str| fs::metadata(folder.path().join(name)).unwrap().permissions().mode() & 0o777;
    fs::write(folder.path().join("plain"), b"").unwrap();
    fs::create_dir(folder.path().join("plain-folder")).unwrap();
    write_file(&folder.path().join("ours"), b"").unwrap();
    OutputDirectory::create(&folder.path().join("our-folder"), false).unwrap().finish().unwrap();
    assert_eq!(mode("ours"), mode("plain"));
    assert_eq!(mode("our-folder"), mode("plain-folder"));
}

#[test]
fn a_folder_appears_when_it_is_finished() {
    let folder = tempfile::tempdir().unwrap();
    let target = folder.path().join("night");
    let output = OutputDirectory::create(&target, false).unwrap();
    fs::write(output.path().join("frame"), b"1").unwrap();
    assert!(!target.exists());
    drop(output);
    assert!(names(folder.path()).is_empty(), "given up, nothing is left");

    let output = OutputDirectory::create(&target, false).unwrap();
    fs::write(output.path().join("frame"), b"1").unwrap();
    output.finish().unwrap();
    assert_eq!(names(folder.path()), ["night"]);
    assert_eq!(fs::read(target.join("frame")).unwrap(), b"1");

    let sentence = OutputDirectory::create(&target, false).unwrap_err().to_string();
    assert!(sentence.contains("night: holds an earlier result") && sentence.contains("--force"), "{sentence}");
    let output = OutputDirectory::create(&target, true).unwrap();
    fs::write(output.path().join("other"), b"2").unwrap();
    assert!(target.join("frame").exists(), "the former result stands until the new one is whole");
    output.finish().unwrap();
    assert!(!target.join("frame").exists() && target.join("other").exists());
    assert_eq!(names(folder.path()), ["night"]);
}

#[test]
fn what_is_not_ours_is_not_replaced() {
    let folder = tempfile::tempdir().unwrap();
    let target = folder.path().join("letters");
    fs::create_dir(&target).unwrap();
    OutputDirectory::create(&target, false).unwrap().finish().unwrap(); // empty: taken
    let target = folder.path().join("more");
    fs::create_dir(&target).unwrap();
    fs::write(target.join("letter.txt"), b"dear").unwrap();
    for force in [false, true] {
        let sentence = OutputDirectory::create(&target, force).unwrap_err().to_string();
        assert!(sentence.contains("was not made by boresight"), "{sentence}");
    }
    let sentence = OutputDirectory::create(&target.join("letter.txt"), true).unwrap_err().to_string();
    assert!(sentence.contains("is a file, not a folder"), "{sentence}");
    assert_eq!(fs::read(target.join("letter.txt")).unwrap(), b"dear");
}
