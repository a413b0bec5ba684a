//! Files of a diagnosis beside diagnose.json: the page, tables, pictures.

use std::path::Path;

use anyhow::{Context, Result};
use boresight::diagnose::{Channel, Diagnosis, EffectState, Finding, PREDICTED, Profile, Unknown};
use boresight::recording::write_file;
use boresight::report;
use boresight::statistics::significance::deviations;

use super::pictures::significant;
use super::pipeline::Measured;
use super::{channel_pictures, diagnose_text};

/// The map of the remainder.
const MAP_TABLE: &str = "map.csv";
/// Its picture.
const MAP_PICTURE: &str = "map.png";
/// Pictures of findings begin so.
const PROFILE: &str = "profile-";

/// Writes summary.txt, residuals.csv, map.csv and the pictures. `size`: columns and rows of the frames. The diagnosis is told where its map is.
pub(crate) fn write(directory: &Path, diagnosis: &mut Diagnosis, measured: &Measured, size: (usize, usize), alpha: f64) -> Result<()> {
    // A map of what is no more than noise is not drawn.
    if let Some(unknown) = diagnosis.unknown.iter_mut().find(|unknown| unknown.field.is_told()) {
        unknown.map = Some(MAP_TABLE.to_owned());
        write_file(&directory.join(MAP_TABLE), &map_table(unknown)?)?;
        map_picture(&directory.join(MAP_PICTURE), unknown, size)?;
    }
    write_file(&directory.join("residuals.csv"), &residual_table(diagnosis, measured)?)?;
    write_file(&directory.join("summary.txt"), diagnose_text::text(diagnosis).as_bytes())?;
    if !diagnosis.residuals.is_empty() {
        residuals(&directory.join("residuals.png"), diagnosis, size)?;
    }
    let ranking = ranking(diagnosis, alpha);
    if !ranking.ranks.is_empty() {
        ranking.write(&directory.join("ranking.png"))?;
    }
    for profile in diagnosis.profiles.iter().filter(|profile| !profile.bins.is_empty()) {
        let name = format!("{PROFILE}{}-{}.png", profile.id, profile.covariate.replace(|c: char| !c.is_ascii_alphanumeric(), "-"));
        profile_plot(profile).write(&directory.join(name))?;
    }
    channel_pictures::write(directory, diagnosis, measured.pixels.as_ref(), size)
}

fn residual_table(diagnosis: &Diagnosis, measured: &Measured) -> Result<Vec<u8>> {
    let mut table = csv::Writer::from_writer(Vec::new());
    table.write_record([
        "frame",
        "file",
        "hip",
        "x_px",
        "y_px",
        "before_x_px",
        "before_y_px",
        "after_x_px",
        "after_y_px",
        "sigma_px",
        "weight",
    ])?;
    for row in &diagnosis.residuals {
        let file = measured.recording.frame_name(row.frame);
        let [before, after] = [row.before_px, row.after_px];
        let numbers = [row.x_px, row.y_px, before[0], before[1], after[0], after[1], row.sigma_px, row.weight];
        let words = [row.frame.to_string(), file, row.hip.to_string()];
        table.write_record(words.into_iter().chain(numbers.map(|number| number.to_string())))?;
    }
    table.into_inner().context("writing residuals.csv")
}

fn map_table(unknown: &Unknown) -> Result<Vec<u8>> {
    let mut table = csv::Writer::from_writer(Vec::new());
    table.write_record(["x_px", "y_px", "dx_px", "dy_px", "sigma_px"])?;
    for point in &unknown.field.points {
        table.write_record(point.map(|number| number.to_string()))?;
    }
    table.into_inner().context("writing map.csv")
}

/// The residual vectors before and after, on one scale.
fn residuals(path: &Path, diagnosis: &Diagnosis, size: (usize, usize)) -> Result<()> {
    let stars = diagnosis.stars_used.with_proper_motion + diagnosis.stars_used.without;
    let panel = |title: &str, residual: fn(&boresight::diagnose::ResidualRow) -> [f64; 2], rms_px: f64| {
        let vectors = diagnosis.residuals.iter().map(|row| {
            let [dx_px, dy_px] = residual(row);
            report::Vector { x_px: row.x_px, y_px: row.y_px, dx_px, dy_px, rejected: row.weight <= 0.0 }
        });
        let vectors: Vec<report::Vector> = vectors.collect();
        let rejected = vectors.iter().filter(|vector| vector.rejected).count();
        report::VectorPanel { title: title.to_owned(), vectors, told: Some(report::FitNumbers { rms_px, stars, rejected }) }
    };
    let displaces = |finding: &&Finding| finding.channels.get(&Channel::Astrometry).is_some_and(Option::is_some);
    let ids: Vec<&str> = diagnosis.findings.iter().filter(displaces).map(|finding| finding.id.as_str()).collect();
    let after = if ids.is_empty() { "after (nothing was found)".to_owned() } else { format!("after, with {}", ids.join(", ")) };
    let fit = &diagnosis.fit;
    let panels = [&panel("before", |row| row.before_px, fit.baseline.rms_px), &panel(&after, |row| row.after_px, fit.after.rms_px)];
    Ok(report::residual_vectors_on_one_scale(
        path,
        "Residuals of the stars' positions, one free attitude a frame, both on one scale",
        size,
        panels,
    )?)
}

/// What is left, in each point of the frame.
fn map_picture(path: &Path, unknown: &Unknown, size: (usize, usize)) -> Result<()> {
    let field = &unknown.field;
    let summary = format!(
        "rms {} px, changes over {} px, {:.0} % of it without curl; {}",
        significant(field.rms_px),
        significant(field.length_px),
        100.0 * field.curl_free_share,
        diagnose_text::chance(unknown.p_value, unknown.p_value_is)
    );
    Ok(report::remainder_map(path, "What is left in the positions and has no name", &summary, size, &field.points)?)
}

/// The hypotheses by significance; a finding by its own fall of χ².
fn ranking(diagnosis: &Diagnosis, alpha: f64) -> report::Ranking {
    let kind = |state: EffectState| match state {
        EffectState::Found => Some(report::RankKind::Found),
        EffectState::Indistinguishable => Some(report::RankKind::InSet),
        EffectState::Withheld => Some(report::RankKind::Withheld),
        EffectState::NotFound => Some(report::RankKind::Tested),
        EffectState::NotObservable | EffectState::NotApplicable => None,
    };
    let in_model = |id: &str| diagnosis.physics.iter().any(|known| known == id);
    let ranks = diagnosis.effects.iter().filter_map(|effect| {
        // What is in the model already is ranked by how far its size is from the one there.
        let label = if in_model(&effect.id) { format!("{} (in the model)", effect.id) } else { effect.id.clone() };
        Some(report::Rank { label, deviations: effect.score_sigma?, kind: kind(effect.status)? })
    });
    let ranks: Vec<report::Rank> = ranks.collect();
    let hypotheses = diagnosis.effective_hypotheses;
    report::Ranking {
        title: "How far each effect stands out of the noise".to_owned(),
        summary: format!("{} effects tested; they count as {} independent hypotheses", ranks.len(), significant(hypotheses)),
        ranks,
        threshold: (hypotheses >= 1.0).then(|| deviations((hypotheses / alpha).ln())),
    }
}

/// The displacements that a finding makes, against what it depends on.
fn profile_plot(profile: &Profile) -> report::ProfilePlot {
    let predicted = profile.covariate == PREDICTED;
    let against = if predicted { "how far it displaces each star image" } else { &profile.covariate };
    report::ProfilePlot {
        title: format!("{}: displacement seen, against {against}", profile.id),
        summary: format!("{}; attitudes, camera and all else found taken off both", diagnose_text::measured(&profile.parameter)),
        x_label: if predicted { format!("displacement that {} predicts / px", profile.id) } else { axis(&profile.covariate) },
        y_label: format!("displacement {} / px", profile.component),
        points: "displacement seen in the bin ± its standard error".to_owned(),
        counted: "stars".to_owned(),
        bins: profile
            .bins
            .iter()
            .map(|bin| report::ProfilePoint { at: bin.at, mean: bin.mean, sigma: bin.sigma, model: bin.model, stars: bin.stars })
            .collect(),
    }
}

/// A covariate with its unit.
fn axis(covariate: &str) -> String {
    let what = match covariate {
        "x" | "y" | "edge-distance" | "pixel-phase-x" | "pixel-phase-y" | "pixel-parity-x" | "pixel-parity-y" => " / px",
        "field-radius" => " / half the frame's width",
        "field-azimuth" => " / rad",
        "magnitude" => " V / mag",
        "colour" => " B − V / mag",
        "flux" => " relative to V = 0",
        "time" => " from the mean / h",
        "temperature" => " from the mean / K",
        "exposure" => " / s",
        "rate" => " / (rad/s)",
        "velocity" => " along the boresight / (km/s)",
        "zenith" => ": displacement for 1 arcsec of refraction at 45° / px",
        "proper-motion" => ": displacement in a year / px",
        "parallax" => ": displacement by parallax / px",
        _ => "",
    };
    format!("{covariate}{what}")
}
