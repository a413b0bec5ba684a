//! Partial output: a name that says so, and a lock of the process that writes. An interrupted process removes its own ([`abandon`]); what a killed
//! one left has a free lock, and the next process that writes beside it removes it.

use std::collections::BTreeSet;
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use tempfile::{Builder, NamedTempFile, TempDir};

const PREFIX: &str = ".boresight-";
const SUFFIX: &str = ".partial";

/// What this process has in the making.
static LIVE: Mutex<Live> = Mutex::new(Live { paths: BTreeSet::new(), swept: BTreeSet::new() });

struct Live {
    paths: BTreeSet<PathBuf>,
    /// Folders in which leftovers have been looked for.
    swept: BTreeSet<PathBuf>,
}

/// While it is held, nothing is begun, and [`abandon`] waits.
fn live() -> MutexGuard<'static, Live> {
    LIVE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Makes a folder and those above it, but not in a process that a signal has stopped.
pub(super) fn make(folder: &Path) -> io::Result<()> {
    let _live = live();
    fs::create_dir_all(folder)
}

/// Names and rights of what is built under another name: the user's own default rights, not the private ones of scratch files.
fn builder(mode: u32) -> Builder<'static, 'static> {
    let mut builder = Builder::new();
    builder.prefix(PREFIX).suffix(SUFFIX);
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        builder.permissions(fs::Permissions::from_mode(mode));
    }
    #[cfg(not(unix))]
    let _ = mode;
    builder
}

/// Whether a name is that of something in the making.
pub(super) fn is_partial(name: &std::ffi::OsStr) -> bool {
    let name = name.as_encoded_bytes();
    name.starts_with(PREFIX.as_bytes()) && name.ends_with(SUFFIX.as_bytes())
}

/// Locks what has just been made, and says whether it is still there: another process may have held it for a leftover before it was locked.
/// Where the file system knows no locks, nothing is ever taken for a leftover.
fn hold(file: &File, path: &Path) -> bool {
    let _ = file.lock();
    path.exists()
}

/// A file in the making. Dropped before it is kept, it leaves nothing behind.
#[derive(Debug)]
pub(super) struct PartialFile(Option<NamedTempFile>);

impl PartialFile {
    pub(super) fn in_folder(folder: &Path) -> io::Result<Self> {
        sweep(folder);
        loop {
            let mut live = live();
            let file = builder(0o666).tempfile_in(folder)?;
            live.paths.insert(file.path().to_owned());
            drop(live);
            let is_there = hold(file.as_file(), file.path());
            let partial = Self(Some(file));
            if is_there {
                return Ok(partial);
            }
        }
    }

    pub(super) fn write_all(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.0.as_mut().map_or(Ok(()), |file| io::Write::write_all(file, bytes))
    }

    /// Waits until the disk has it.
    pub(super) fn sync(&self) -> io::Result<()> {
        self.0.as_ref().map_or(Ok(()), |file| file.as_file().sync_all())
    }

    /// Gives the file its name.
    pub(super) fn keep_as(mut self, path: &Path) -> io::Result<()> {
        let Some(file) = self.0.take() else { return Ok(()) };
        let mut live = live();
        live.paths.remove(file.path());
        file.persist(path).map(drop).map_err(|error| error.error)
    }
}

impl Drop for PartialFile {
    fn drop(&mut self) {
        if let Some(file) = self.0.take() {
            let mut live = live();
            live.paths.remove(file.path());
            drop(file);
        }
    }
}

/// A folder in the making. Dropped before it is kept, it leaves nothing behind.
#[derive(Debug)]
pub(super) struct PartialFolder {
    folder: Option<TempDir>,
    path: PathBuf,
    /// Held open for its lock.
    _lock: Option<File>,
}

impl PartialFolder {
    pub(super) fn in_folder(parent: &Path) -> io::Result<Self> {
        sweep(parent);
        loop {
            let mut live = live();
            let folder = builder(0o777).tempdir_in(parent)?;
            let path = folder.path().to_owned();
            live.paths.insert(path.clone());
            drop(live);
            let lock = File::open(&path).ok();
            let is_there = lock.as_ref().map_or(path.exists(), |lock| hold(lock, &path));
            let partial = Self { folder: Some(folder), path, _lock: lock };
            if is_there {
                return Ok(partial);
            }
        }
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Gives the folder its name; what stood there before is removed.
    pub(super) fn keep_as(mut self, target: &Path, parent: &Path) -> io::Result<()> {
        let former = if target.exists() { Some(Self::in_folder(parent)?) } else { None };
        // Between the two renamings nobody may come and take either folder away.
        let mut live = live();
        if let Some(aside) = &former {
            fs::rename(target, aside.path.join("former"))?;
        }
        if let Err(error) = fs::rename(&self.path, target) {
            if let Some(aside) = &former {
                fs::rename(aside.path.join("former"), target)?;
            }
            return Err(error);
        }
        live.paths.remove(&self.path);
        if let Some(folder) = self.folder.take() {
            let _ = folder.keep(); // it lives on under its new name
        }
        Ok(())
    }
}

impl Drop for PartialFolder {
    fn drop(&mut self) {
        if let Some(folder) = self.folder.take() {
            // Longer than the lock is to be held: a recording may be many files.
            drop(folder);
            live().paths.remove(&self.path);
        }
    }
}

/// Takes away what killed processes left in a folder, once for each folder.
fn sweep(folder: &Path) {
    if !live().swept.insert(folder.to_owned()) {
        return;
    }
    let Ok(entries) = fs::read_dir(folder) else { return };
    for entry in entries.flatten().filter(|entry| is_partial(&entry.file_name())) {
        let path = entry.path();
        let is_ours = entry.file_type().is_ok_and(|kind| kind.is_file() || kind.is_dir());
        let Some(file) = is_ours.then(|| File::open(&path).ok()).flatten() else { continue };
        if file.try_lock().is_ok() && remove(&path).is_ok() {
            tracing::info!("{}: left by a run that was killed, removed", path.display());
        }
    }
}

fn remove(path: &Path) -> io::Result<()> {
    if path.is_dir() { fs::remove_dir_all(path) } else { fs::remove_file(path) }
}

/// Takes away what this process has in the making, and lets nothing be begun any more: for a process that is about to end.
pub fn abandon() {
    /// Other threads may still write into a folder that is being removed.
    const TRIES: usize = 100;
    let live = live();
    for path in &live.paths {
        for _ in 0..TRIES {
            if remove(path).is_ok() || !path.exists() {
                break;
            }
            std::thread::sleep(Duration::from_millis(5));
        }
    }
    super::results::abandon();
    std::mem::forget(live); // never to be opened again
}
