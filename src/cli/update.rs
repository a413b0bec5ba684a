//! `boresight calibrate --update`: a calibration is updated with new frames.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use boresight::calibrate::{Drift, FORMAT, OnChange, SEQUENTIAL_FORMAT, Sequential, UpdateOptions, UpdateReport, UpdateResult};
use boresight::guard::guarded;
use boresight::identify::ControlPoints;
use boresight::provenance::Provenance;
use boresight::recording::{ResultFolder, SkippedFrame};
use clap::{Args, ValueEnum};

use super::calibrate_text::with_sigma;
use super::options::{OutputArgs, heading};
use super::{Answer, map, output};

/// Arguments of an update.
#[derive(Debug, Args)]
#[command(next_help_heading = heading::UPDATE)]
pub(crate) struct UpdateArgs {
    /// Go on from this calibration (calibrate.json, or sequential.json of an earlier update) with the frames of the recording; the
    /// parameters and the model are those of the file. Writes DIR/sequential.json, whose size does not grow
    #[arg(long, value_name = "FILE", conflicts_with_all = ["solve", "prior", "method", "projection", "attitudes", "threshold", "max_iterations", "all_stars", "options"])]
    pub(crate) update: Option<PathBuf>,
    /// Old frames count 1/e after this many new ones (default: nothing is forgotten)
    #[arg(long, value_name = "FRAMES", requires = "update", value_parser = super::identify::positive)]
    forget: Option<f64>,
    /// A parameter drifts: standard deviation of its random walk over one frame, in its own unit; several times for several
    #[arg(long, value_name = "NAME=SIGMA", requires = "update", value_parser = drift)]
    drift: Vec<Drift>,
    /// What to do with frames of a camera that has changed: refuse them (exit code 3), average them in, or restart from them
    #[arg(long, value_enum, value_name = "WHAT", requires = "update", default_value_t = OnChangeChoice::Refuse)]
    on_change: OnChangeChoice,
}

/// What is done with frames of a camera that has changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum OnChangeChoice {
    /// They are not taken
    Refuse,
    /// They are taken like all others
    Average,
    /// They are taken, and what was known before is forgotten
    Restart,
}

/// A drift as written on the command line.
fn drift(text: &str) -> std::result::Result<Drift, String> {
    let parsed = text.split_once('=').and_then(|(name, sigma)| {
        let sigma_per_frame: f64 = sigma.trim().parse().ok()?;
        Some(Drift { name: name.trim().to_owned(), sigma_per_frame })
    });
    parsed
        .filter(|drift| drift.sigma_per_frame > 0.0 && drift.sigma_per_frame.is_finite())
        .ok_or_else(|| "write name=sigma, for example f=0.01".into())
}

impl UpdateArgs {
    fn options(&self) -> UpdateOptions {
        UpdateOptions {
            forget_frames: self.forget,
            drift: self.drift.clone(),
            on_change: match self.on_change {
                OnChangeChoice::Refuse => OnChange::Refuse,
                OnChangeChoice::Average => OnChange::Average,
                OnChangeChoice::Restart => OnChange::Restart,
            },
            ..UpdateOptions::default()
        }
    }
}

/// What to go on from: a sequential state, or a calibration to begin one with.
pub(crate) fn read(path: &Path) -> Result<Sequential> {
    let name = path.display();
    let text = std::fs::read_to_string(path).with_context(|| format!("{name}: the calibration cannot be read"))?;
    let no_state = || {
        format!("{name}: this is nothing to update; give a calibrate.json or sequential.json as `boresight calibrate … -o DIR` writes them")
    };
    let value: serde_json::Value = guarded(|| serde_json::from_str(&text))?.with_context(no_state)?;
    match value.get("format").and_then(serde_json::Value::as_str) {
        // Calculations are made in the un-mirrored image, and files hold the stored one.
        Some(FORMAT) => Sequential::from_calibration(&map::read_calibration(path)?).with_context(|| name.to_string()),
        Some(SEQUENTIAL_FORMAT) => guarded(|| serde_json::from_value(value))?.with_context(|| name.to_string()),
        Some(other) => bail!("{name}: the format is {other:?}, but an update goes on from {FORMAT:?} or {SEQUENTIAL_FORMAT:?}"),
        None => bail!(no_state()),
    }
}

/// The folder of an update. To write in the place of the very file that it goes on from is what an update is for.
pub(crate) fn folder(from: &Path, to: &OutputArgs) -> Result<Option<ResultFolder>> {
    let Some(folder) = &to.output else { return Ok(None) };
    let goes_on = folder.join("sequential.json").canonicalize().is_ok_and(|there| from.canonicalize().is_ok_and(|from| from == there));
    Ok(Some(ResultFolder::open(folder, "sequential", to.force || goes_on)?))
}

/// The new frames, as far as they are prepared.
pub(crate) struct NewFrames<'a> {
    /// Their control points, in the un-mirrored image.
    pub(crate) points: &'a ControlPoints,
    /// −1 if the images are mirrored.
    pub(crate) parity: i8,
    /// Frames that could not be read.
    pub(crate) skipped: &'a [SkippedFrame],
    /// What to mind.
    pub(crate) notes: Vec<String>,
}

/// Updates, and prints the parameters before and after.
pub(crate) fn update(path: &Path, args: &UpdateArgs, new: NewFrames, mut provenance: Provenance, to: &OutputArgs) -> Result<Answer> {
    let mut state = read(path)?;
    provenance.add_input(path)?;
    let side = |parity: i8| if parity < 0 { "mirrored" } else { "not mirrored" };
    ensure!(
        state.parity() == new.parity,
        "{}: its images are {}, those of the new frames {}: update with frames that are stored in the same way",
        path.display(),
        side(state.parity()),
        side(new.parity)
    );
    let frames_before = state.frames();
    let report = state.update_with(new.points, &args.options()).with_context(|| path.display().to_string())?;
    let report = in_stored_columns(report, &state);
    let answer = if report.taken { Answer::Yes } else { Answer::No };
    let object = UpdateResult { state: &state, frames_before, update: report, skipped: new.skipped, notes: new.notes, provenance };
    output::deliver("sequential", &object, to.json, to.output.as_deref(), || text(&object))?;
    Ok(answer)
}

/// The report in the columns of the images as stored.
fn in_stored_columns(mut report: UpdateReport, state: &Sequential) -> UpdateReport {
    if state.parity() > 0 {
        return report;
    }
    let last = state.camera().width_px as f64 - 1.0;
    for parameter in &mut report.parameters {
        match parameter.name.as_str() {
            "x0" => (parameter.before, parameter.after) = (last - parameter.before, last - parameter.after),
            "p1" => (parameter.before, parameter.after) = (-parameter.before, -parameter.after),
            _ => continue,
        }
        parameter.moved_sigma = -parameter.moved_sigma;
    }
    report
}

/// The update for people.
fn text(object: &UpdateResult) -> String {
    let report = &object.update;
    let rows: Vec<Vec<String>> = report
        .parameters
        .iter()
        .map(|parameter| {
            let [before, sigma_before] = with_sigma(parameter.before, parameter.sigma_before);
            let [after, sigma_after] = with_sigma(parameter.after, parameter.sigma_after);
            vec![
                parameter.name.clone(),
                before,
                format!("± {sigma_before}"),
                after,
                format!("± {sigma_after}"),
                format!("{:+.1} σ", parameter.moved_sigma),
                parameter.unit.clone(),
            ]
        })
        .collect();
    let mut text = boresight::report::table(&["parameter", "before", "σ", "after", "σ", "moved", "unit"], &rows);
    text += &format!(
        "\n{} of {} new star images used in {} frames, rms {}; {} frames and {} star images so far\n",
        report.stars,
        report.stars_offered,
        report.frames,
        report.rms_px.map_or_else(|| "unknown".to_owned(), |rms| format!("{rms:.4} px")),
        object.state.frames(),
        object.state.stars()
    );
    text += &format!(
        "the same camera? χ² = {:.1} for {} combinations of parameters, p = {:.2e}\n",
        report.change_chi_squared, report.change_degrees, report.change_probability
    );
    if !report.converged {
        text += "NOT CONVERGED: the new frames are not taken, and the calibration stays as it was\n";
    } else if report.changed {
        text += if report.taken {
            "THE CAMERA HAS CHANGED: the new frames are taken all the same, as asked for\n"
        } else {
            "THE CAMERA HAS CHANGED: the new frames are not taken; --on-change restart begins anew with them, average takes them as they are\n"
        };
    }
    for note in report.warnings.iter().chain(&object.notes) {
        text += &format!("warning: {note}\n");
    }
    text
}
