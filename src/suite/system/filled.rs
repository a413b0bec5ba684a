//! The command of the system under test with its places filled in.

use std::path::Path;
use std::process::Command;

use super::super::frames::HandedFrame;

/// What is filled in.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Places<'a> {
    pub(super) image: Option<&'a Path>,
    pub(super) answer: Option<&'a Path>,
    pub(super) recording: Option<&'a Path>,
    pub(super) truth: Option<&'a Path>,
    pub(super) frame: Option<&'a HandedFrame>,
    pub(super) size_px: [usize; 2],
}

/// The command, ready to be started.
pub(super) fn command(words: &[String], places: &Places<'_>) -> Command {
    let path = |path: Option<&Path>| path.map_or_else(String::new, |path| path.display().to_string());
    let of_frame = |of: &dyn Fn(&HandedFrame) -> String| places.frame.map_or_else(String::new, of);
    let [width, height] = places.size_px;
    let known = [
        ("{image}", path(places.image)),
        ("{answer}", path(places.answer)),
        ("{recording}", path(places.recording)),
        ("{truth}", path(places.truth)),
        ("{frame}", of_frame(&|frame| frame.number.to_string())),
        ("{time_utc}", of_frame(&|frame| frame.truth.time.map_or_else(String::new, |time| time.to_isoformat() + "Z"))),
        ("{exposure_s}", of_frame(&|frame| frame.truth.exposure_s.to_string())),
        ("{width_px}", width.to_string()),
        ("{height_px}", height.to_string()),
    ];
    let filled = |word: &String| known.iter().fold(word.clone(), |word, (place, own)| word.replace(place, own));
    let mut words = words.iter().map(filled);
    let mut command = Command::new(words.next().unwrap_or_default());
    command.args(words);
    command
}
