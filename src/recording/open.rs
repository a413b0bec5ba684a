//! Opening a recording: from paths to its form, with a check of every frame before any is read.

use std::fs;
use std::path::{Path, PathBuf};

use hifitime::Duration;

use super::error::{FrameProblem, FrameSize, ManifestKey, RecordingError};
use super::fits::{FitsHeader, FitsMetadata};
use super::image_file::{self, FITS_ENDINGS, IMAGE_ENDINGS, Probe};
use super::manifest::{self, ListedFrame, Manifest};
use super::{CameraInfo, Form, FrameEntry, OpenOptions, Recording, Site, SkippedFrame, StarList, star_list, time};
use crate::statistics::order::sort_by_key;

pub(super) fn open(paths: &[&Path], options: OpenOptions) -> Result<Recording, RecordingError> {
    let Some(first) = paths.first() else {
        return Err(RecordingError::Empty { path: PathBuf::from("."), hint: "give a recording or images".to_owned() });
    };
    for path in paths {
        if let Err(error) = fs::metadata(path) {
            let path = path.to_path_buf();
            return Err(match error.kind() {
                std::io::ErrorKind::NotFound | std::io::ErrorKind::NotADirectory => RecordingError::Missing { path },
                _ => RecordingError::Read { path, source: error },
            });
        }
    }
    if let [path] = paths {
        if path.is_dir() {
            let manifest = path.join(manifest::FILE_NAME);
            return if manifest.is_file() { from_manifest(&manifest, options) } else { from_folder(path, options) };
        }
        if is_toml(path) {
            return from_manifest(path, options);
        }
    } else if let Some(path) = paths.iter().find(|path| path.is_dir() || is_toml(path)) {
        let problem = "a recording is given alone; give one recording, or images only".to_owned();
        return Err(RecordingError::Inputs { path: path.to_path_buf(), problem });
    }
    if let Some(path) = paths.iter().find(|path| ending(path).is_some_and(|ending| ending == "csv" || ending == "parquet")) {
        let problem = "a star list is given through a recording.toml with stars = \"FILE\" and the frames it belongs to".to_owned();
        return Err(RecordingError::Inputs { path: path.to_path_buf(), problem });
    }
    let files: Vec<PathBuf> = paths.iter().map(|path| path.to_path_buf()).collect();
    from_images(PathBuf::new(), &files, Form::Images, first, options)
}

fn ending(path: &Path) -> Option<String> {
    path.extension().map(|ending| ending.to_string_lossy().to_lowercase())
}

/// The ending of an image's name: of `a.fits.gz` it is `fits`.
fn image_ending(path: &Path) -> Option<String> {
    let ending = ending(path)?;
    if ending == "gz" {
        self::ending(Path::new(path.file_stem()?)).filter(|inner| FITS_ENDINGS.contains(&inner.as_str()))
    } else {
        Some(ending)
    }
}

fn is_toml(path: &Path) -> bool {
    ending(path).as_deref() == Some("toml")
}

/// Form B, or form C in order of name.
fn from_folder(directory: &Path, options: OpenOptions) -> Result<Recording, RecordingError> {
    let read = |source| RecordingError::Read { path: directory.to_owned(), source };
    let mut files = Vec::new();
    for entry in fs::read_dir(directory).map_err(read)? {
        let path = entry.map_err(read)?.path();
        let hidden = path.file_name().is_some_and(|name| name.to_string_lossy().starts_with('.'));
        if !hidden && path.is_file() {
            files.extend(path.file_name().map(PathBuf::from));
        }
    }
    files.sort();
    let of_kind = |endings: &[&str]| -> Vec<PathBuf> {
        files.iter().filter(|file| image_ending(file).is_some_and(|ending| endings.contains(&ending.as_str()))).cloned().collect()
    };
    let (fits, images) = (of_kind(&FITS_ENDINGS), of_kind(&IMAGE_ENDINGS));
    match (fits.as_slice(), images.as_slice()) {
        ([], []) => Err(RecordingError::Empty {
            path: directory.to_owned(),
            hint: format!(
                "it holds neither {} nor files ending in {} or {}",
                manifest::FILE_NAME,
                FITS_ENDINGS.join(", "),
                IMAGE_ENDINGS.join(", ")
            ),
        }),
        (fits, []) => from_images(directory.to_owned(), fits, Form::FitsFolder, directory, options),
        ([], images) => from_images(directory.to_owned(), images, Form::Images, directory, options),
        ([fits, ..], [image, ..]) => Err(RecordingError::Inputs {
            path: directory.to_owned(),
            problem: format!("it holds FITS files ({}) and other images ({}); give the frames one by one", fits.display(), image.display()),
        }),
    }
}

/// Forms B and C: `files` relative to `directory`.
fn from_images(directory: PathBuf, files: &[PathBuf], form: Form, given: &Path, options: OpenOptions) -> Result<Recording, RecordingError> {
    let of_one_camera = !directory.as_os_str().is_empty();
    let mut kept: Vec<(FrameEntry, FitsMetadata)> = Vec::new();
    let mut more: Vec<String> = Vec::new();
    let mut turned: Vec<Turned> = Vec::new();
    let mut skipped = Vec::new();
    for (number, file) in files.iter().enumerate() {
        let path = directory.join(file);
        let first = kept.first().and_then(|(entry, ..)| Some((entry.name(), entry.size?))).filter(|_| of_one_camera);
        match examine(&path, file, number, first, options) {
            Ok((entry, metadata, probe)) => {
                turned.extend(Turned::of(&entry, &probe));
                more.extend(probe.more_images.then(|| more_images(&entry, probe.fits.is_some())));
                kept.push((entry, metadata));
            }
            Err(problem) => {
                let error = RecordingError::Frame { file: path, problem: Box::new(problem), place: None };
                skip_or_fail(error, file.display().to_string(), number, options, &mut skipped)?;
            }
        }
    }
    if kept.is_empty() {
        return Err(RecordingError::Empty { path: given.to_owned(), hint: all_skipped(&skipped) });
    }
    if form == Form::FitsFolder && kept.iter().all(|(entry, ..)| entry.time_utc.is_some()) {
        sort_by_key(&mut kept, |(entry, ..)| entry.time_utc);
    }
    let mut notes = more;
    let (camera, site) = shared(&kept, &mut notes);
    for (entry, metadata) in &kept {
        notes.extend(metadata.notes.iter().map(|note| format!("{}: {note}", entry.name())));
    }
    let frames: Vec<FrameEntry> = kept.into_iter().map(|(entry, _)| entry).collect();
    note_flips(&frames, &mut notes);
    note_zones(&frames, &mut notes);
    note_turns(turned, files.len(), &mut notes);
    Ok(Recording {
        camera,
        mount: None,
        site,
        frames,
        stars: None,
        directory,
        form,
        manifest: None,
        star_file: None,
        skipped,
        notes,
        keep_going: options.keep_going,
        plane: options.plane,
    })
}

/// One image of forms B and C.
fn examine(
    path: &Path,
    file: &Path,
    number: usize,
    first: Option<(String, FrameSize)>,
    options: OpenOptions,
) -> Result<(FrameEntry, FitsMetadata, Probe), FrameProblem> {
    let probe = image_file::probe(path, options.plane)?;
    if let Some((name, expected)) = first.filter(|(_, expected)| *expected != probe.size) {
        return Err(FrameProblem::WrongSize { found: probe.size, expected, expected_from: format!("{name} is") });
    }
    let mut metadata = probe.fits.as_ref().map_or_else(|| Ok(FitsMetadata::default()), FitsHeader::metadata)?;
    let mut zone_unknown = false;
    if let Some(exif) = &probe.exif {
        (metadata.exposure_s, metadata.focal_length_mm) = (exif.exposure_s, exif.focal_length_mm);
        let middle = |start| start + Duration::from_seconds(exif.exposure_s.unwrap_or(0.0) / 2.0);
        metadata.time_utc = exif.start.map(|(start, _)| middle(start));
        zone_unknown = exif.start.is_some_and(|(_, unknown)| unknown);
    }
    let mut entry = FrameEntry {
        file: Some(file.to_owned()),
        number,
        time_utc: metadata.time_utc,
        zone_unknown,
        exposure_s: metadata.exposure_s,
        temperature_c: metadata.temperature_c,
        ..FrameEntry::default()
    };
    if let Some(gain) = metadata.gain_setting {
        entry.covariates.insert("gain_setting".to_owned(), gain);
    }
    describe(&mut entry, &probe);
    Ok((entry, metadata, probe))
}

fn describe(entry: &mut FrameEntry, probe: &Probe) {
    entry.size = Some(probe.size);
    entry.rows_flipped = probe.fits.as_ref().is_some_and(|header| header.bottom_up);
}

/// Camera and site, as far as all headers that speak of them agree.
fn shared(kept: &[(FrameEntry, FitsMetadata)], notes: &mut Vec<String>) -> (CameraInfo, Option<Site>) {
    let size = kept.first().and_then(|(entry, _)| entry.size).unwrap_or(FrameSize { width_px: 0, height_px: 0 });
    let mut agreed = |keyword: &str, get: &dyn Fn(&FitsMetadata) -> Option<f64>| {
        let mut values = kept.iter().filter_map(|(entry, metadata)| Some((entry, get(metadata)?)));
        let (_, first) = values.next()?;
        if let Some((entry, other)) = values.find(|(_, value)| (value - first).abs() > 1e-4 * first.abs().max(1e-3)) {
            notes.push(format!("{}: {keyword} is {other}, but {first} in the first frame that has it; it is not used", entry.name()));
            return None;
        }
        Some(first)
    };
    let pitch = [
        agreed("XPIXSZ", &|metadata| metadata.pixel_pitch_um.map(|[x, _]| x)),
        agreed("YPIXSZ", &|metadata| metadata.pixel_pitch_um.map(|[_, y]| y)),
    ];
    let camera = CameraInfo {
        width_px: size.width_px,
        height_px: size.height_px,
        pixel_pitch_um: pitch[0].zip(pitch[1]).map(|(x, y)| [x, y]),
        focal_length_mm: agreed("the focal length (FOCALLEN)", &|metadata| metadata.focal_length_mm),
        gain_e_per_dn: agreed("EGAIN or GAIN", &|metadata| metadata.gain_e_per_dn),
        ..CameraInfo::default()
    };
    let latitude_deg = agreed("SITELAT", &|metadata| metadata.latitude_deg);
    let longitude_deg = agreed("SITELONG", &|metadata| metadata.longitude_deg);
    let height_m = agreed("SITEELEV", &|metadata| metadata.height_m).unwrap_or(0.0);
    let site = latitude_deg.zip(longitude_deg).map(|(latitude_deg, longitude_deg)| Site {
        latitude_deg,
        longitude_deg,
        height_m,
        pressure_hpa: None,
        temperature_c: None,
        relative_humidity: None,
    });
    (camera, site)
}

/// Forms A and D.
fn from_manifest(path: &Path, options: OpenOptions) -> Result<Recording, RecordingError> {
    let Manifest { path, camera, width_line, mount, site, stars: named, frames: listed } = manifest::read(path)?;
    if listed.is_empty() {
        let hint = "it has no [[frames]]; list every frame (an image's file, or the telemetry of a star list)".to_owned();
        return Err(RecordingError::Empty { path, hint });
    }
    let directory = path.parent().map(Path::to_owned).unwrap_or_default();
    let camera_size = FrameSize { width_px: camera.width_px, height_px: camera.height_px };
    let (star_file, mut listed_stars) = match named {
        Some((file, place)) => {
            let file = directory.join(file);
            let stars = read_stars(&file, place, listed.len(), camera_size)?;
            (Some(file), Some(stars))
        }
        None => (None, None),
    };
    let mut notes = Vec::new();
    let (mut frames, mut skipped): (Vec<FrameEntry>, Vec<SkippedFrame>) = (Vec::new(), Vec::new());
    let mut turned: Vec<Turned> = Vec::new();
    let listed_frames = listed.len();
    let mut latest = None;
    for (number, ListedFrame { name, time_place, entry }) in listed.into_iter().enumerate() {
        let checked = entry.and_then(|mut entry| {
            let file = entry.file.as_ref().map_or_else(|| PathBuf::from(&name), |file| directory.join(file));
            let fault = |problem| RecordingError::Frame { file: file.clone(), problem: Box::new(problem), place: entry.place.clone() };
            if let Some((time, previous)) = entry.time_utc.zip(latest).filter(|(time, previous)| time < previous) {
                let (time, previous) = (time::format_utc(time), time::format_utc(previous));
                let place = Some(time_place);
                return Err(RecordingError::Frame { file, problem: Box::new(FrameProblem::TimeBackwards { time, previous }), place });
            }
            if let Some(listed_stars) = &mut listed_stars {
                entry.size = Some(camera_size);
                return listed_stars.faults.remove(&number).map_or(Ok(entry), Err);
            }
            let probe =
                if image_file::is_raw(&file) { image_file::probe_raw(&file, camera_size) } else { image_file::probe(&file, options.plane) };
            let probe = probe.map_err(fault)?;
            if probe.size != camera_size {
                let expected_from = format!("the camera ({}, line {width_line}, width_px and height_px) is", path.display());
                return Err(fault(FrameProblem::WrongSize { found: probe.size, expected: camera_size, expected_from }));
            }
            describe(&mut entry, &probe);
            notes.extend(probe.more_images.then(|| more_images(&entry, probe.fits.is_some())));
            turned.extend(Turned::of(&entry, &probe));
            Ok(entry)
        });
        match checked {
            Ok(entry) => {
                latest = entry.time_utc.or(latest);
                frames.push(entry);
            }
            Err(error) => skip_or_fail(error, name, number, options, &mut skipped)?,
        }
    }
    if frames.is_empty() {
        return Err(RecordingError::Empty { path, hint: all_skipped(&skipped) });
    }
    note_focal_length(&camera, &mut notes);
    note_flips(&frames, &mut notes);
    note_turns(turned, listed_frames, &mut notes);
    let stars = listed_stars
        .map(|mut listed| StarList { frames: frames.iter().map(|frame| std::mem::take(&mut listed.stars[frame.number])).collect() });
    Ok(Recording {
        camera,
        mount,
        site,
        frames,
        form: if stars.is_some() { Form::StarList } else { Form::Manifest },
        stars,
        directory,
        manifest: Some(path),
        star_file,
        skipped,
        notes,
        keep_going: options.keep_going,
        plane: options.plane,
    })
}

fn read_stars(file: &Path, place: ManifestKey, frames: usize, size: FrameSize) -> Result<star_list::Listed, RecordingError> {
    if ending(file).as_deref() == Some("parquet") {
        return Err(RecordingError::Parquet { path: file.to_owned(), place });
    }
    if !file.is_file() {
        return Err(RecordingError::MissingStarList { path: file.to_owned(), place });
    }
    star_list::read(file, frames, size)
}

fn skip_or_fail(
    error: RecordingError,
    file: String,
    number: usize,
    options: OpenOptions,
    skipped: &mut Vec<SkippedFrame>,
) -> Result<(), RecordingError> {
    if !options.keep_going {
        return Err(error);
    }
    skipped.push(SkippedFrame { file, number, reason: error.to_string() });
    Ok(())
}

fn all_skipped(skipped: &[SkippedFrame]) -> String {
    skipped.first().map_or_else(
        || "give images".to_owned(),
        |first| format!("every one of its {} frames was skipped, the first because {}", skipped.len(), first.reason),
    )
}

fn more_images(entry: &FrameEntry, is_fits: bool) -> String {
    let hint = if is_fits { "" } else { " (--plane N chooses another page)" };
    format!("{}: the file holds more than one image; the first is read, the others are not{hint}", entry.name())
}

/// Says which focal length is used where the manifest gives two.
fn note_focal_length(camera: &CameraInfo, notes: &mut Vec<String>) {
    let from_mm = CameraInfo { focal_length_px: None, ..camera.clone() }.nominal_focal_length_px();
    if let Some((px, from_mm)) = camera.focal_length_px.zip(from_mm).filter(|(px, from_mm)| (px / from_mm - 1.0).abs() > 0.01) {
        notes
            .push(format!("focal_length_px is {px}, but focal_length_mm and pixel_pitch_um make it {from_mm:.1}; focal_length_px is used"));
    }
}

fn note_flips(frames: &[FrameEntry], notes: &mut Vec<String>) {
    let flipped: Vec<String> = frames.iter().filter(|frame| frame.rows_flipped).map(FrameEntry::name).collect();
    if let Some(first) = flipped.first() {
        notes.push(format!(
            "{} of {} frames say ROWORDER = BOTTOM-UP and were turned over on reading: {first} …",
            flipped.len(),
            frames.len()
        ));
    }
}

/// An image that viewers turn.
struct Turned {
    name: String,
    size: FrameSize,
    orientation: u8,
}

impl Turned {
    fn of(entry: &FrameEntry, probe: &Probe) -> Option<Self> {
        let orientation = probe.exif.as_ref()?.orientation?;
        Some(Self { name: entry.name(), size: probe.size, orientation })
    }
}

/// Says that images are read as they are stored where other programs turn them (EXIF, tag Orientation).
fn note_turns(turned: Vec<Turned>, frames: usize, notes: &mut Vec<String>) {
    let count = turned.len();
    let Some(Turned { name, size, orientation }) = turned.into_iter().next() else { return };
    let how = match orientation {
        2 => "mirrored left to right",
        3 => "turned by 180°",
        4 => "mirrored top to bottom",
        5 => "mirrored along the diagonal",
        6 => "turned clockwise by 90°",
        7 => "mirrored along the other diagonal",
        _ => "turned counter-clockwise by 90°",
    };
    let FrameSize { width_px, height_px } = size;
    let shown = if orientation >= 5 { FrameSize { width_px: height_px, height_px: width_px } } else { size };
    notes.push(format!(
        "{count} of {frames} frames have an EXIF orientation, {name} the first of them ({orientation}): viewers and cv2.imread show it {how}, as \
         {shown}; here pixels and positions are as stored, {size}; read it elsewhere without turning it (cv2.IMREAD_IGNORE_ORIENTATION) to use them"
    ));
}

/// Says that times are taken for UTC that do not say so.
fn note_zones(frames: &[FrameEntry], notes: &mut Vec<String>) {
    let unknown: Vec<&FrameEntry> = frames.iter().filter(|frame| frame.zone_unknown).collect();
    if let Some((first, time)) = unknown.first().and_then(|frame| Some((frame.name(), frame.time_utc?))) {
        notes.push(format!(
            "the zone of the times of {} frames is unknown (EXIF without OffsetTimeOriginal), {first} at {} the first of them: they are taken for \
             UTC and may be off by 14 hours; tell the times (--time) if that matters",
            unknown.len(),
            time::format_utc(time)
        ));
    }
}
