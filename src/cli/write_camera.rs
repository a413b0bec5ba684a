//! `boresight diagnose --write-camera`: camera and sky with the findings, as a scene that `boresight simulate` renders.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context as _, Result, bail};
use boresight::camera::Model;
use boresight::catalog::Catalog;
use boresight::coordinates::{Attitude, Direction, Icrs, PixelPoint};
use boresight::detect::Detection;
use boresight::diagnose::{ColumnSource, Diagnosis, ResidualRow};
use boresight::effects::ids;
use boresight::effects::{Context, Observation, displacement};
use boresight::identify::{ControlPoint, ControlPoints};
use boresight::recording::{Site, write_file};
use boresight::scene::{DetectorTable, EffectTable, FrameTable, NominalTable, Scene, SceneFile, SiteTable, SkyTable, TrueCameraTable};
use boresight::units::DEG_RAD;
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

use super::found_image::{DetectorNumbers, found_image};
use super::pipeline::Measured;

/// Where nobody says how long frames were exposed; the stars' brightness counts for the same time.
const ASSUMED_EXPOSURE_S: f64 = 1.0;
/// The scene has what was found if it puts every star as near to where the fit has it.
const SAME_PX: f64 = 1e-3;
/// Stars that much fainter than the faintest identified are rendered too.
const FAINTER: f64 = 0.3;

/// Writes the scene; returns what to mind of it. `points`: those that were diagnosed, of the un-mirrored image.
pub(crate) fn write(
    path: &Path,
    diagnosis: &Diagnosis,
    points: &ControlPoints,
    measured: &Measured,
    catalog: &Catalog,
    seed: u64,
) -> Result<Vec<String>> {
    let model = model(diagnosis, points)?;
    let known = |frame: usize| observation(diagnosis, points, frame);
    let attitudes = attitudes(diagnosis, points, &model, &known);
    let (mut frames, mut missing) = (Vec::new(), Vec::new());
    for frame in &measured.frames {
        match attitudes.get(&frame.index) {
            Some(attitude) => frames.push(FrameTable {
                zenith_radec_deg: zenith_radec_deg(diagnosis, frame.index),
                ..frame_table(measured, frame.index, attitude)
            }),
            None => missing.push(frame.name.clone()),
        }
    }
    if frames.is_empty() {
        bail!("--write-camera: no frame has an attitude");
    }
    let numbers = DetectorNumbers::of(diagnosis, &measured.recording.camera);
    let mut file = scene_file(&model, points, measured, &numbers, catalog, seed, frames);
    let size_px = [file.camera.width_px, file.camera.height_px];
    let mut found = found_image(diagnosis, &mut file.detector, size_px);
    found.left_out.extend(numbers.assumed());
    for stage in found.effects {
        // A stage in the pixels moves the stars by itself: beside the formula of the same id it would move them twice.
        if file.effects.iter().any(|own| own.id == stage.id) {
            found.left_out.push(format!("{} moves the stars by its formula, and its stage in the pixels is left out", stage.id));
        } else {
            file.effects.push(stage);
        }
    }
    (file.psf, file.ghosts, file.cosmic_rays) = (found.psf, found.ghosts, found.cosmic_rays);
    file.sky.extinction_mag_per_airmass = found.extinction_mag_per_airmass.unwrap_or(file.sky.extinction_mag_per_airmass);
    let name = path.display().to_string();
    let text =
        "# The camera, its attitudes and every effect in force as `boresight diagnose` found them. Render it with `boresight simulate`.\n"
            .to_owned()
            + &toml::to_string(&file).context("writing the scene as TOML")?;
    // What cannot be rendered is said now, and not when somebody tries.
    let scene = Scene::parse(&name, &text).context("--write-camera: the camera found cannot be rendered")?;
    let mut notes = Vec::new();
    let order: Vec<usize> = measured.frames.iter().map(|frame| frame.index).filter(|index| attitudes.contains_key(index)).collect();
    if let Some((frame, off_px)) = farthest(&scene, &model, diagnosis, points, (&attitudes, &order), &known)
        && off_px > SAME_PX
    {
        let off = off(&name, measured, frame, off_px);
        if order.len() == measured.recording.frames.len() {
            bail!("--write-camera: {off}: it cannot hold what was found, and is not written");
        }
        notes.push(format!("{off}: telemetry counts from its mean over the frames, and some are left out"));
    }
    write_file(path, text.as_bytes())?;
    notes.extend(lacking(&name, diagnosis, measured, &missing));
    notes.extend(found.left_out.into_iter().map(|what| format!("the scene {name}: {what}")));
    Ok(notes)
}

/// The scene's tables.
fn scene_file(
    model: &Model,
    points: &ControlPoints,
    measured: &Measured,
    numbers: &DetectorNumbers,
    catalog: &Catalog,
    seed: u64,
    frames: Vec<FrameTable>,
) -> SceneFile {
    let camera = *model.camera();
    let nominal = points.nominal;
    SceneFile {
        format: "boresight-scene/1".to_owned(),
        seed,
        first_frame: 0,
        camera: TrueCameraTable {
            binning: None,
            width_px: camera.width_px,
            height_px: camera.height_px,
            focal_length_px: camera.focal_length_px,
            principal_point_px: Some(camera.principal_point_px),
            k1: camera.k1,
            p1: camera.p1,
            p2: camera.p2,
            projection: Some(model.projection().to_owned()).filter(|id| id != ids::PINHOLE),
            projection_parameters: model.projection_parameters().to_vec(),
            line_time_us: None,
            first_row: measured.recording.camera.first_row,
        },
        nominal: NominalTable {
            focal_length_px: Some(nominal.focal_length_px),
            principal_point_px: Some(nominal.principal_point_px),
            k1: Some(nominal.k1),
            p1: Some(nominal.p1),
            p2: Some(nominal.p2),
            line_time_us: measured.recording.camera.line_time_us,
        },
        detector: detector(measured, numbers, &matched(points, measured)),
        sky: SkyTable {
            background_e_per_px_s: Some(background_e_per_px_s(measured, numbers)),
            faintest_magnitude: faintest(points),
            physics: "none".to_owned(),
            ..SkyTable::default()
        },
        site: measured.recording.site.as_ref().map(site),
        orbit: None,
        psf: None,
        ghosts: Vec::new(),
        streaks: Vec::new(),
        cosmic_rays: None,
        mount: None,
        jitter: None,
        effects: effects(model, points, catalog),
        series: None,
        frames,
    }
}

/// How far off the scene is, in words.
fn off(name: &str, measured: &Measured, frame: usize, off_px: f64) -> String {
    let named = measured.frames.iter().find(|other| other.index == frame).map_or_else(String::new, |frame| frame.name.clone());
    format!("the scene {name} puts stars up to {off_px:.3} px from where the fit has them (in {named})")
}

/// What the scene lacks of what was found, one sentence each.
fn lacking(name: &str, diagnosis: &Diagnosis, measured: &Measured, missing: &[String]) -> Vec<String> {
    let mut notes = Vec::new();
    if !missing.is_empty() {
        notes.push(format!("the scene {name} lacks the frames without a known attitude: {}", missing.join(", ")));
    }
    if measured.frames.iter().any(|frame| measured.recording.frames[frame.index].exposure_s.is_none()) {
        notes.push(format!("the scene {name} takes {ASSUMED_EXPOSURE_S} s for exposures of which nothing is said"));
    }
    let rendered = diagnosis.findings.iter().filter(|finding| finding.columns == ColumnSource::Rendered);
    notes.extend(rendered.map(|finding| {
        format!(
            "the scene {name} moves stars by the formula of {id} at the size found, not by its traces in pixels: `boresight effects {id}` has the stage that makes them",
            id = finding.id
        )
    }));
    notes
}

/// What is known of a frame, and the zenith that was found.
fn observation(diagnosis: &Diagnosis, points: &ControlPoints, frame: usize) -> Observation {
    let known = points.observation(frame);
    match zenith_radec_deg(diagnosis, frame) {
        Some([ra, dec]) => {
            let zenith = Direction::<Icrs>::from_radec_rad(ra * DEG_RAD, dec * DEG_RAD).xyz;
            Observation { zenith: Some(zenith), zenith_is_guessed: true, ..known }
        }
        None => known,
    }
}

fn zenith_radec_deg(diagnosis: &Diagnosis, frame: usize) -> Option<[f64; 2]> {
    diagnosis.zeniths.iter().find(|zenith| zenith.frame == frame).map(|zenith| zenith.radec_deg)
}

/// The farthest that a star of the scene stands from where the model has it, px, and the frame of that. `order`: the scene's frames.
fn farthest(
    scene: &Scene,
    model: &Model,
    diagnosis: &Diagnosis,
    points: &ControlPoints,
    (attitudes, order): (&BTreeMap<usize, Attitude>, &[usize]),
    known: &dyn Fn(usize) -> Observation,
) -> Option<(usize, f64)> {
    let of = |row: &ResidualRow| {
        let ControlPoint { frame, star, image, .. } = points.points.get(row.point).filter(|_| row.weight > 0.5)?;
        let exposure = scene.exposures.get(order.iter().position(|other| other == frame)?);
        let context = Context::new(*star, known(*frame)).with_image(*image);
        let fitted = model.pixel(&attitudes.get(frame)?.camera_from_apparent(&model.apparent(&context)), &context)?;
        let rendered = Context::new(*star, *exposure.sky.observation()).with_image(*image);
        let apparent = exposure.sky.apparent_in(star, exposure.sky.observation());
        let seen = scene.model.pixel(&exposure.attitude.camera_from_apparent(&apparent), &rendered)?;
        Some((*frame, (seen.x_px - fitted.x_px).hypot(seen.y_px - fitted.y_px)))
    };
    diagnosis.residuals.iter().filter_map(of).max_by(|a, b| a.1.total_cmp(&b.1))
}

/// The model found, with the effects that the points' directions contain. Where a zenith was found it stands with the frames.
fn model(diagnosis: &Diagnosis, points: &ControlPoints) -> Result<Model> {
    let mut model = diagnosis.camera.clone().context("--write-camera: the diagnosis has no camera")?;
    let refraction = model.terms().find(|(id, _)| *id == ids::REFRACTION).map(|(_, parameters)| parameters.to_vec());
    if let Some([strength, ..]) = refraction.as_deref().filter(|_| !diagnosis.zeniths.is_empty()) {
        model.set(ids::REFRACTION, &[*strength, 0.0, 0.0])?;
    }
    let in_force: Vec<String> = model.terms().map(|(id, _)| id.to_owned()).collect();
    for term in points.sky.iter().filter(|term| !in_force.contains(&term.effect)) {
        model.set(&term.effect, &term.parameters)?;
    }
    Ok(model)
}

fn effects(model: &Model, points: &ControlPoints, catalog: &Catalog) -> Vec<EffectTable> {
    let table = |(id, values): (&'static str, &[f64])| {
        let specs = displacement(id).map_or(&[][..], |effect| effect.parameters());
        let mut parameters: BTreeMap<String, f64> = specs.iter().zip(values).map(|(spec, value)| (spec.name.to_owned(), *value)).collect();
        // Where no time is known the stars were taken at an assumed one, and a scene without times has them at the catalogue's epoch.
        let assumed = points.frames.iter().find_map(|frame| frame.observation.epoch_yr).filter(|_| !times_are_known(points));
        if let (Some(epoch), Some(offset)) = (assumed, parameters.get_mut("epoch_offset_yr")) {
            *offset += epoch - catalog.epoch_yr;
        }
        EffectTable { id: id.to_owned(), parameters }
    };
    model.terms().map(table).collect()
}

/// Whether the epochs of the frames are those of known times: only then the place of the Earth is known too.
fn times_are_known(points: &ControlPoints) -> bool {
    points.frames.iter().any(|frame| frame.observation.position_au.is_some())
}

/// Each frame's attitude at the model: the rotation with the least sum of squared distances between the directions seen and those from
/// which the light arrives, weighted with the star images' errors (Kabsch's solution of Wahba's problem).
fn attitudes(
    diagnosis: &Diagnosis,
    points: &ControlPoints,
    model: &Model,
    known: &dyn Fn(usize) -> Observation,
) -> BTreeMap<usize, Attitude> {
    const MIN_STARS: usize = 2;
    let mut sums: BTreeMap<usize, (Matrix3<f64>, usize)> = BTreeMap::new();
    for row in diagnosis.residuals.iter().filter(|row| row.weight > 0.5 && row.sigma_px > 0.0) {
        let Some(ControlPoint { frame, x_px, y_px, star, image, .. }) = points.points.get(row.point) else { continue };
        let context = Context::new(*star, known(*frame)).with_image(*image);
        let Some(seen) = model.direction(PixelPoint { x_px: *x_px, y_px: *y_px }, &context) else { continue };
        let apparent = model.apparent(&context);
        let (sum, count) = sums.entry(*frame).or_insert((Matrix3::zeros(), 0));
        *sum += Vector3::from(seen.xyz) * Vector3::from(apparent.xyz).transpose() * (row.weight / (row.sigma_px * row.sigma_px));
        *count += 1;
    }
    let attitude = |(frame, (sum, count)): (usize, (Matrix3<f64>, usize))| {
        let svd = sum.svd(true, true);
        let (u, v) = (svd.u?, svd.v_t?);
        let turned = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, (u * v).determinant().signum()));
        let rotation = Rotation3::from_matrix_unchecked(u * turned * v);
        (count >= MIN_STARS).then(|| (frame, Attitude::new(UnitQuaternion::from_rotation_matrix(&rotation))))
    };
    sums.into_iter().filter_map(attitude).collect()
}

fn frame_table(measured: &Measured, index: usize, attitude: &Attitude) -> FrameTable {
    let entry = &measured.recording.frames[index];
    let [ra, dec, roll] = attitude.pointing_rad();
    FrameTable {
        time_utc: entry.time_utc.map(|time| time.to_isoformat() + "Z"),
        exposure_s: entry.exposure_s.unwrap_or(ASSUMED_EXPOSURE_S),
        boresight_radec_deg: Some([ra / DEG_RAD, dec / DEG_RAD]),
        roll_deg: roll / DEG_RAD,
        velocity_km_s: entry.velocity_km_s,
        rate_deg_s: entry.rate_deg_s,
        attitude_samples: Vec::new(),
        temperature_c: entry.temperature_c,
        pressure_hpa: entry.covariates.get("pressure_hpa").copied(),
        zenith_radec_deg: None,
    }
}

fn site(site: &Site) -> SiteTable {
    SiteTable {
        latitude_deg: site.latitude_deg,
        longitude_deg: site.longitude_deg,
        height_m: site.height_m,
        pressure_hpa: site.pressure_hpa,
        temperature_c: site.temperature_c,
        relative_humidity: site.relative_humidity,
    }
}

/// The control points with their measurements.
fn matched<'a>(points: &'a ControlPoints, measured: &'a Measured) -> Vec<(&'a ControlPoint, &'a Detection)> {
    let last_px = points.nominal.width_px as f64 - 1.0;
    let of = |point: &'a ControlPoint| {
        let frame = measured.frames.iter().find(|frame| frame.index == point.frame)?;
        let same = |x_px: f64| (x_px - point.x_px).abs() < 1e-6 || (last_px - x_px - point.x_px).abs() < 1e-6;
        let star = frame.detections.stars.iter().find(|star| (star.y_px - point.y_px).abs() < 1e-6 && same(star.x_px))?;
        Some((point, star))
    };
    points.points.iter().filter_map(of).collect()
}

/// The detector as the recording declares it, and as stars and sky show it where it says nothing.
fn detector(measured: &Measured, numbers: &DetectorNumbers, matched: &[(&ControlPoint, &Detection)]) -> DetectorTable {
    let camera = &measured.recording.camera;
    let plain = DetectorTable::default();
    let (gain_e_per_dn, bias_dn) = (numbers.gain_e_per_dn(), numbers.bias_dn());
    let saturation_dn = camera.saturation_dn.unwrap_or(plain.top_dn()).clamp(bias_dn + 1.0, plain.top_dn());
    let usable = || matched.iter().filter(|(point, star)| point.magnitude < 90.0 && !star.flags.saturated && star.flux_dn > 0.0);
    let exposure_s = |frame: usize| measured.recording.frames[frame].exposure_s.unwrap_or(ASSUMED_EXPOSURE_S);
    let zero_point = |(point, star): &(&ControlPoint, &Detection)| {
        star.flux_dn * gain_e_per_dn * 10.0_f64.powf(0.4 * point.magnitude) / exposure_s(point.frame)
    };
    DetectorTable {
        psf_sigma_px: median(usable().map(|(_, star)| star.width_px)).unwrap_or(plain.psf_sigma_px).clamp(0.2, 20.0),
        zero_point_e_per_s: numbers.zero_point_e_per_s.or_else(|| median(usable().map(zero_point))).unwrap_or(plain.zero_point_e_per_s),
        gain_e_per_dn,
        bias_dn,
        read_noise_e: numbers.read_noise_e.or_else(|| read_noise_e(measured, gain_e_per_dn, bias_dn)).unwrap_or(plain.read_noise_e),
        saturation_dn: Some(saturation_dn),
        full_well_e: plain.full_well_e.max((saturation_dn - bias_dn) * gain_e_per_dn),
        ..plain
    }
}

/// What the background's noise has beyond that of its own light.
fn read_noise_e(measured: &Measured, gain_e_per_dn: f64, bias_dn: f64) -> Option<f64> {
    let seen = measured.frames.iter().map(|frame| &frame.detections).filter(|seen| seen.noise_dn > 0.0);
    let variance = |seen: &boresight::detect::Detections| {
        (seen.noise_dn * gain_e_per_dn).powi(2) - ((seen.background_dn - bias_dn) * gain_e_per_dn).max(0.0)
    };
    median(seen.map(variance)).map(|variance| variance.max(0.0).sqrt())
}

fn background_e_per_px_s(measured: &Measured, numbers: &DetectorNumbers) -> f64 {
    let (gain, bias) = (numbers.gain_e_per_dn(), numbers.bias_dn());
    let of = |frame: &super::pipeline::MeasuredFrame| {
        let exposure_s = measured.recording.frames[frame.index].exposure_s.unwrap_or(ASSUMED_EXPOSURE_S);
        (frame.detections.background_dn - bias) * gain / exposure_s
    };
    median(measured.frames.iter().map(of)).unwrap_or(0.0).max(0.0)
}

fn faintest(points: &ControlPoints) -> f64 {
    let known = points.points.iter().map(|point| point.magnitude).filter(|magnitude| *magnitude < 90.0);
    known.reduce(f64::max).map_or(SkyTable::default().faintest_magnitude, |magnitude| magnitude + FAINTER)
}

fn median(values: impl Iterator<Item = f64>) -> Option<f64> {
    let mut values: Vec<f64> = values.filter(|value| value.is_finite()).collect();
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}
