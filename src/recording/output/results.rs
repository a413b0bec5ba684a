//! Result folders, into which several verbs may write beside the user's own files: each verb lists the files that it wrote, so that it can replace
//! them, and them alone.
//!
//! The list is the hidden file `.boresight`: a first line that says who wrote it, then a line for each file, verb and path, the path with `%XX` for
//! what is no plain character.

use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::fs::{self, File, OpenOptions};
use std::io::Write as _;
use std::path::{Component, Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use super::partial::PartialFile;
use super::{MARK, OutputError, parent, partial, write_error};

/// The end of the first line of a list of files; folders that were made as a whole have another.
pub(super) const LISTED: &str = "files listed";

/// The folders of results of this process.
static OPEN: Mutex<Vec<Open>> = Mutex::new(Vec::new());

struct Open {
    folder: PathBuf,
    verb: &'static str,
    /// What the verb wrote there earlier; removed before it writes again.
    former: Option<BTreeSet<PathBuf>>,
    written: BTreeSet<PathBuf>,
    list: Option<File>,
    /// Folders that were made for it, the outermost first.
    made: Vec<PathBuf>,
}

fn open_folders() -> MutexGuard<'static, Vec<Open>> {
    OPEN.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A folder for the results of a verb: made, tried and ready before the work. If nothing is ever written into it, it goes again.
#[derive(Debug)]
pub struct ResultFolder {
    folder: PathBuf,
}

impl ResultFolder {
    /// Opens a folder for `verb`. One that holds an earlier result of the same verb is refused unless `force`; then the files of that result are
    /// removed when the first new one is written, and nothing else is.
    pub fn open(folder: &Path, verb: &'static str, force: bool) -> Result<Self, OutputError> {
        if folder.exists() && !folder.is_dir() {
            return Err(OutputError::NotAFolder { path: folder.to_owned() });
        }
        let former = former(folder, verb);
        if !former.is_empty() && !force {
            return Err(OutputError::Earlier { path: folder.to_owned(), verb });
        }
        let made = make(folder).map_err(write_error(folder))?;
        let tried = PartialFile::in_folder(folder);
        let open = Open { folder: folder.to_owned(), verb, former: Some(former), written: BTreeSet::new(), list: None, made };
        if let Err(source) = tried {
            open.unmake();
            return Err(write_error(folder)(source));
        }
        open_folders().push(open);
        Ok(Self { folder: folder.to_owned() })
    }

    /// Where it is.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.folder
    }

    /// Removes the earlier result now, and not when the first new file is written.
    pub fn begin(&self) -> Result<(), OutputError> {
        open_folders().iter_mut().find(|open| open.folder == self.folder).map_or(Ok(()), Open::begin)
    }
}

impl Drop for ResultFolder {
    fn drop(&mut self) {
        let mut folders = open_folders();
        if let Some(place) = folders.iter().position(|open| open.folder == self.folder) {
            folders.swap_remove(place).unmake();
        }
    }
}

/// Takes away folders that were made and into which nothing has been written.
pub(super) fn abandon() {
    open_folders().iter().for_each(Open::unmake);
}

/// Notes that a file is about to be written; the first in a folder of results removes the earlier ones.
pub(super) fn note(path: &Path) -> Result<(), OutputError> {
    for open in open_folders().iter_mut() {
        let Ok(inside) = path.strip_prefix(&open.folder) else { continue };
        if inside.components().any(|part| partial::is_partial(part.as_os_str())) {
            continue;
        }
        open.begin()?;
        if open.written.insert(inside.to_owned())
            && let Some(list) = &mut open.list
        {
            let line = format!("{} {}\n", open.verb, coded(inside));
            list.write_all(line.as_bytes()).map_err(write_error(&open.folder.join(MARK)))?;
        }
    }
    Ok(())
}

impl Open {
    fn begin(&mut self) -> Result<(), OutputError> {
        let Some(former) = self.former.take() else { return Ok(()) };
        for file in &former {
            let path = self.folder.join(file);
            match fs::remove_file(&path) {
                Err(source) if source.kind() != std::io::ErrorKind::NotFound => return Err(write_error(&path)(source)),
                _ => {}
            }
            // Folders of their own that are empty now.
            for above in file.ancestors().skip(1).take_while(|above| !above.as_os_str().is_empty()) {
                if fs::remove_dir(self.folder.join(above)).is_err() {
                    break;
                }
            }
        }
        let mark = self.folder.join(MARK);
        let mut text = String::new();
        for (number, line) in fs::read_to_string(&mark).unwrap_or_default().lines().enumerate() {
            if number == 0 || line.split(' ').next() != Some(self.verb) {
                text += line;
                text.push('\n');
            }
        }
        if text.is_empty() {
            text = format!("boresight {}, {LISTED}\n", env!("CARGO_PKG_VERSION"));
        }
        let error = write_error(&mark);
        fs::write(&mark, text).map_err(&error)?;
        self.list = Some(OpenOptions::new().append(true).open(&mark).map_err(&error)?);
        Ok(())
    }

    /// Removes the folders that were made, as far as they are empty.
    fn unmake(&self) {
        for folder in self.made.iter().rev() {
            if fs::remove_dir(folder).is_err() {
                break;
            }
        }
    }
}

/// Makes a folder and those above it, and says which were made.
fn make(folder: &Path) -> std::io::Result<Vec<PathBuf>> {
    let mut made: Vec<PathBuf> =
        folder.ancestors().take_while(|above| !above.as_os_str().is_empty() && !above.exists()).map(Path::to_owned).collect();
    made.reverse();
    fs::create_dir_all(folder)?;
    Ok(made)
}

/// The files that `verb` wrote into a folder earlier, as far as they are there.
fn former(folder: &Path, verb: &str) -> BTreeSet<PathBuf> {
    let list = fs::read_to_string(folder.join(MARK)).unwrap_or_default();
    let of_verb = list.lines().skip(1).filter_map(|line| line.split_once(' ')).filter(|(of, _)| *of == verb);
    let own = PathBuf::from(format!("{verb}.json"));
    // A list that somebody changed must not reach beyond the folder.
    let is_inside = |path: &PathBuf| path.components().all(|part| matches!(part, Component::Normal(_)));
    of_verb.map(|(_, path)| decoded(path)).filter(is_inside).chain([own]).filter(|path| folder.join(path).is_file()).collect()
}

/// A path in plain characters.
fn coded(path: &Path) -> String {
    let mut text = String::new();
    for byte in path.as_os_str().as_encoded_bytes() {
        if byte.is_ascii_graphic() && *byte != b'%' || *byte == b' ' {
            text.push(char::from(*byte));
        } else {
            let _ = write!(text, "%{byte:02X}"); // writing to a String cannot fail
        }
    }
    text
}

/// The path again.
fn decoded(text: &str) -> PathBuf {
    let mut bytes = Vec::new();
    let mut rest = text.as_bytes();
    while let [first, tail @ ..] = rest {
        let code = tail.get(..2).and_then(|digits| std::str::from_utf8(digits).ok()).and_then(|digits| u8::from_str_radix(digits, 16).ok());
        match code.filter(|_| *first == b'%') {
            Some(byte) => (bytes.push(byte), rest = &tail[2..]),
            None => (bytes.push(*first), rest = tail),
        };
    }
    #[cfg(unix)]
    {
        use std::os::unix::ffi::OsStringExt;
        PathBuf::from(std::ffi::OsString::from_vec(bytes))
    }
    #[cfg(not(unix))]
    PathBuf::from(String::from_utf8_lossy(&bytes).into_owned())
}

/// A file that a verb will write: its folder is made and tried before the work. One that is there is refused unless `force`.
pub fn check_file(path: &Path, force: bool) -> Result<(), OutputError> {
    if path.is_dir() {
        return Err(OutputError::NotAFile { path: path.to_owned() });
    }
    if path.exists() && !force {
        return Err(OutputError::FileExists { path: path.to_owned() });
    }
    let made = make(parent(path)).map_err(write_error(path))?;
    let tried = PartialFile::in_folder(parent(path)).map(drop);
    // What fails leaves nothing; the folder is made again when the file is written.
    for folder in made.iter().rev() {
        if fs::remove_dir(folder).is_err() {
            break;
        }
    }
    tried.map_err(write_error(path))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn any_path_comes_back_from_the_list() {
        for name in ["plain.png", "a b/c%20d.png", "nächtlich\n.csv", "%", "%zz"] {
            let path = Path::new(name);
            assert_eq!(decoded(&coded(path)), path, "{name}");
            assert!(coded(path).is_ascii() && !coded(path).contains('\n'), "{name}");
        }
    }
}
