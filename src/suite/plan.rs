//! A suite that is checked: every path, metric and number is known to be good before the first frame is rendered.

use std::path::{Path, PathBuf};

use toml::{Spanned, Table, Value};

use super::attitudes::{AttitudePlan, read_list};
use super::conventions::{Conventions, PixelOrigin, SignedAxes};
use super::error::SuiteError;
use super::metric::{AnswerNeeds, Metric, Statistic};
use super::scene_tables::{check_pointable, dotted, list_exposures, put, with_frames};
use super::suite_file::{
    AttitudeKind, AttitudeTable, CaseTable, FrameCount, RequirementLevel, RequirementTable, SUITE_FORMAT, SuiteFile, SystemMode,
    SystemTable,
};
use super::verdict::{RequirementLimit, fewest_frames};
use super::when::When;
use crate::dataset::{DatasetPlan, ScenePath};
use crate::effects::{DISPLACEMENTS, displacement};
use crate::scene::{Scene, preset, schema};
use crate::toml_file::{Lines, suggestion, tables};

/// A suite.
#[derive(Debug)]
pub struct SuitePlan {
    /// The file, as messages call it.
    pub path: String,
    /// Its text.
    pub text: String,
    /// Its tables.
    pub file: SuiteFile,
    /// Conventions of the system under test.
    pub conventions: Conventions,
    /// Its cases.
    pub cases: Vec<PlannedCase>,
}

/// What the frames of a case are made of.
#[derive(Debug)]
pub(super) enum CaseFrames {
    /// The tables of a scene, and what messages call it.
    Scene { path: String, tables: Box<Table> },
    /// A recipe.
    Dataset(Box<DatasetPlan>),
}

/// A case.
#[derive(Debug)]
pub struct PlannedCase {
    /// Its name.
    pub name: String,
    /// Its line in the suite.
    pub line: usize,
    pub(super) frames_of: CaseFrames,
    pub(super) attitudes: AttitudePlan,
    pub(super) sweep: Option<PlannedSweep>,
    /// Frames of each value; `None`: until all is decided.
    pub(super) frames: Option<usize>,
    pub(super) max_frames: usize,
    pub(super) within_rad: f64,
    pub(super) about_within_rad: f64,
    pub(super) night_frames: usize,
    pub(super) hidden: Vec<String>,
    size_px: [usize; 2],
    /// Its requirements.
    pub requirements: Vec<PlannedRequirement>,
}

/// A sweep.
#[derive(Debug)]
pub(super) struct PlannedSweep {
    pub(super) name: String,
    pub(super) path: ScenePath,
    pub(super) values: Vec<Value>,
}

/// A requirement.
#[derive(Debug)]
pub struct PlannedRequirement {
    /// The name of its metric.
    pub name: String,
    /// The metric.
    pub metric: Metric,
    /// The limit.
    pub limit: RequirementLimit,
    /// How sure a PASS is to be.
    pub confidence: f64,
    /// What hangs on it.
    pub level: RequirementLevel,
    /// Its line in the suite.
    pub line: usize,
    pub(super) when: Option<When>,
}

impl PlannedCase {
    /// Columns and rows of its frames.
    #[must_use]
    pub fn size_px(&self) -> [usize; 2] {
        self.size_px
    }

    /// How many values the sweep has; without one, one.
    #[must_use]
    pub fn values(&self) -> usize {
        self.sweep.as_ref().map_or(1, |sweep| sweep.values.len())
    }

    /// A value of the sweep in words: `rate = 0.5`; empty without a sweep.
    #[must_use]
    pub fn value_words(&self, value: usize) -> String {
        self.sweep.as_ref().map_or_else(String::new, |sweep| format!("{} = {}", sweep.name, sweep.values[value]))
    }

    /// Whether a requirement applies to a value of the sweep.
    #[must_use]
    pub fn applies(&self, requirement: &PlannedRequirement, value: usize) -> bool {
        match (&requirement.when, &self.sweep) {
            (Some(when), Some(sweep)) => when.holds(&sweep.values[value]),
            _ => true,
        }
    }
}

impl SuitePlan {
    /// Reads and checks a suite.
    pub fn open(path: &Path, seed: Option<u64>) -> Result<Self, SuiteError> {
        let name = path.display().to_string();
        let text = read(path)?;
        Self::parse(&name, text, path.parent().unwrap_or(Path::new(".")), seed)
    }

    /// Checks the text of a suite; `path` is used in messages, and files that it names begin at `folder`.
    pub fn parse(path: &str, text: String, folder: &Path, seed: Option<u64>) -> Result<Self, SuiteError> {
        let mut file: SuiteFile = tables(&text).map_err(|message| SuiteError::Parse { path: path.to_owned(), message })?;
        if let Some(seed) = seed {
            file.seed = seed;
        }
        let checker = Checker { path, folder, lines: Lines::new(&text), file: &file };
        let conventions = checker.head()?;
        let cases = file.cases.iter().map(|case| checker.case(case)).collect::<Result<Vec<_>, _>>()?;
        for (index, case) in cases.iter().enumerate() {
            if let Some(first) = cases[..index].iter().find(|other| other.name == case.name) {
                return Err(checker
                    .wrong(case.line, format!("the name {:?} is that of the case in line {}; give it another", case.name, first.line)));
            }
        }
        Ok(Self { path: path.to_owned(), conventions, cases, text, file })
    }

    /// How many requirements are judged, each for every value of its sweep: among so many the risk of a false FAIL is divided.
    #[must_use]
    pub fn judged(&self) -> usize {
        let of_case = |case: &PlannedCase| -> usize {
            (0..case.values()).map(|value| case.requirements.iter().filter(|requirement| case.applies(requirement, value)).count()).sum()
        };
        self.cases.iter().map(of_case).sum::<usize>().max(1)
    }

    /// What the system under test is called.
    #[must_use]
    pub fn system_name(&self) -> String {
        match &self.file.system {
            None => "boresight".to_owned(),
            Some(system) => system.name.clone().unwrap_or_else(|| system.command.first().cloned().unwrap_or_default()),
        }
    }
}

fn read(path: &Path) -> Result<String, SuiteError> {
    std::fs::read_to_string(path).map_err(|source| SuiteError::Read { path: path.display().to_string(), source })
}

/// What looks at a suite's tables.
struct Checker<'a> {
    path: &'a str,
    folder: &'a Path,
    lines: Lines,
    file: &'a SuiteFile,
}

impl Checker<'_> {
    fn wrong(&self, line: usize, message: String) -> SuiteError {
        SuiteError::Suite { path: self.path.to_owned(), line, message }
    }

    /// Checks what is no case.
    fn head(&self) -> Result<Conventions, SuiteError> {
        let wrong = |message: String| SuiteError::Parse { path: self.path.to_owned(), message };
        if self.file.format != SUITE_FORMAT {
            return Err(wrong(format!("format = {:?} is no suite; write format = {SUITE_FORMAT:?}", self.file.format)));
        }
        Self::confidence(self.file.confidence).map_err(wrong)?;
        if self.file.cases.is_empty() {
            return Err(wrong("there is no [[case]]; `boresight test --init PRESET` writes a suite to begin from".to_owned()));
        }
        match &self.file.system {
            None => Ok(Conventions::default()),
            Some(system) => Self::system(system).map_err(wrong),
        }
    }

    fn system(system: &SystemTable) -> Result<Conventions, String> {
        if system.command.is_empty() {
            return Err("system.command is empty; name the program and its arguments".to_owned());
        }
        if !(system.timeout_s > 0.0 && system.timeout_s <= 3600.0) {
            return Err(format!("system.timeout_s = {} must be above 0, 3600 at most", system.timeout_s));
        }
        if let Some(fault) = system.scaling.as_ref().and_then(super::suite_file::ScalingTable::fault) {
            return Err(fault);
        }
        if !(1..=64).contains(&system.workers) {
            return Err(format!("system.workers = {} must be from 1 to 64", system.workers));
        }
        let names = |place: &str| system.command.iter().any(|word| word.contains(place));
        let needed: &[&str] = match system.mode {
            SystemMode::Frame => &["{image}", "{answer}"],
            SystemMode::Batch => &["{recording}", "{answer}"],
            SystemMode::Stream => &[],
        };
        if let Some(missing) = needed.iter().find(|place| !names(place)) {
            return Err(format!("system.command does not say where {missing} goes, which this mode fills in: add it as an argument"));
        }
        let known = ["image", "answer", "recording", "frame", "time_utc", "exposure_s", "truth", "width_px", "height_px"];
        for word in system.command.iter().flat_map(|word| word.split('{').skip(1)).filter_map(|rest| rest.split_once('}')) {
            if !known.contains(&word.0) {
                let meant = suggestion(word.0, &known).map_or_else(|| known.join(", "), |near| format!("did you mean {{{near}}}?"));
                return Err(format!("system.command: {{{}}} is filled in by nothing; {meant}", word.0));
            }
        }
        let mut conventions = super::answers::usual_conventions(system.answer);
        let table = &system.conventions;
        if let Some(axes) = &table.axes {
            conventions.axes = SignedAxes::parse(axes).map_err(|fault| format!("system.conventions.{fault}"))?;
        }
        (conventions.rotation, conventions.quaternion) = (table.rotation, table.quaternion);
        conventions.pixel_origin = match &table.pixel_origin {
            None => PixelOrigin::At(0.0),
            Some(Value::Float(first)) => PixelOrigin::At(*first),
            Some(Value::Integer(first)) => PixelOrigin::At(*first as f64),
            Some(Value::String(word)) if word == "middle" => PixelOrigin::Middle,
            Some(other) => return Err(format!("system.conventions.pixel_origin = {other} is none; write 0, 0.5, 1 or \"middle\"")),
        };
        Ok(conventions)
    }

    fn confidence(confidence: f64) -> Result<(), String> {
        if (0.5..1.0).contains(&confidence) { Ok(()) } else { Err(format!("confidence = {confidence} must be from 0.5 to below 1")) }
    }

    fn case(&self, spanned: &Spanned<CaseTable>) -> Result<PlannedCase, SuiteError> {
        let (case, line) = (spanned.get_ref(), self.lines.line(spanned.span().start));
        let wrong = |message: String| self.wrong(line, message);
        if case.name.trim().is_empty() {
            return Err(wrong("name is empty; name the case".to_owned()));
        }
        let table = case.attitudes.table();
        let frames_of = self.frames_of(case, &table).map_err(&wrong)?;
        let sweep = case.sweep.as_ref().map(planned_sweep).transpose().map_err(&wrong)?;
        if sweep.is_some() && matches!(frames_of, CaseFrames::Dataset(_)) {
            return Err(wrong("a recipe draws its values itself; leave sweep out, or name a scene".to_owned()));
        }
        let frames = match &case.frames {
            FrameCount::Exactly(0) => return Err(wrong("frames = 0; give at least one frame".to_owned())),
            FrameCount::Exactly(count) => Some(*count),
            FrameCount::Word(word) if word == "auto" => None,
            FrameCount::Word(word) => return Err(wrong(format!("frames = {word:?}; give a number or \"auto\""))),
        };
        check_numbers(case, &table).map_err(&wrong)?;
        if let Some(id) = case.hidden.iter().find(|id| displacement(id).is_none()) {
            let known: Vec<&str> = DISPLACEMENTS.iter().map(|effect| effect.id()).collect();
            let meant =
                suggestion(id, &known).map_or_else(|| "`boresight effects` lists them".to_owned(), |near| format!("did you mean {near}?"));
            return Err(wrong(format!("hidden: there is no effect {id}; {meant}")));
        }
        let camera = first_scene(&case.name, &frames_of)?.camera;
        let list = self.list(&table).map_err(&wrong)?;
        let attitudes = AttitudePlan::new(self.file.seed, &case.name, table, list, camera.focal_length_px);
        let about_within = case.about_within_arcsec.unwrap_or(20.0 * case.within_arcsec);
        let mut planned = PlannedCase {
            name: case.name.clone(),
            line,
            frames_of,
            attitudes,
            sweep,
            frames,
            max_frames: case.max_frames,
            within_rad: case.within_arcsec * crate::units::ARCSEC_RAD,
            about_within_rad: about_within * crate::units::ARCSEC_RAD,
            night_frames: case.night_frames,
            hidden: case.hidden.clone(),
            size_px: [camera.width_px, camera.height_px],
            requirements: Vec::new(),
        };
        for value in 0..planned.values() {
            planned.scene_text(value, 0..1).map_err(|message| wrong(format!("{}: {message}", planned.value_words(value))))?;
        }
        for requirement in &case.require {
            let own = self.requirement(&planned, requirement)?;
            planned.requirements.push(own);
        }
        Ok(planned)
    }

    /// Opens the scene or the recipe.
    fn frames_of(&self, case: &CaseTable, attitudes: &AttitudeTable) -> Result<CaseFrames, String> {
        let named = [&case.scene, &case.preset, &case.dataset].into_iter().flatten().count();
        if named != 1 {
            return Err("a case has either scene, preset or dataset; name one of them".to_owned());
        }
        if let Some(recipe) = &case.dataset {
            if !case.set.is_empty() || attitudes.kind != AttitudeKind::Uniform {
                return Err("a recipe has attitudes and values of its own; leave attitudes and set out".to_owned());
            }
            let plan = DatasetPlan::open(&self.folder.join(recipe)).map_err(|error| error.to_string())?;
            return Ok(CaseFrames::Dataset(Box::new(plan)));
        }
        let (path, text) = match (&case.scene, &case.preset) {
            (Some(scene), _) => {
                let path: PathBuf = self.folder.join(scene);
                let text = std::fs::read_to_string(&path)
                    .map_err(|error| format!("scene = {scene:?} cannot be read: {}: {error}", path.display()))?;
                (path.display().to_string(), text)
            }
            (None, name) => {
                let name = name.as_deref().unwrap_or_default();
                let found = preset(name).ok_or_else(|| {
                    let names: Vec<&str> = crate::scene::PRESETS.iter().map(|preset| preset.name).collect();
                    let meant = suggestion(name, &names)
                        .map_or_else(|| format!("there are {}", names.join(", ")), |near| format!("did you mean {near}?"));
                    format!("there is no preset {name:?}; {meant}")
                })?;
                (format!("preset {name}"), found.toml.to_owned())
            }
        };
        let mut tables: Table = tables(&text).map_err(|message| format!("{path}: {message}"))?;
        if attitudes.kind != AttitudeKind::Scene {
            list_exposures(&mut tables);
        }
        let root = schema();
        for (place, value) in &case.set {
            let found = ScenePath::find(&root, &dotted(place)).map_err(|message| format!("set: {message}"))?;
            put(&found, &mut tables, value).map_err(|message| format!("set: {message}"))?;
        }
        if attitudes.kind != AttitudeKind::Scene {
            check_pointable(&tables)?;
        }
        Ok(CaseFrames::Scene { path, tables: Box::new(tables) })
    }

    fn list(&self, table: &AttitudeTable) -> Result<Vec<crate::coordinates::Attitude>, String> {
        match (table.kind, &table.file) {
            (AttitudeKind::List, Some(file)) => {
                let path = self.folder.join(file);
                let text =
                    std::fs::read_to_string(&path).map_err(|error| format!("attitudes: {} cannot be read: {error}", path.display()))?;
                read_list(&text).map_err(|message| format!("attitudes: {}: {message}", path.display()))
            }
            (AttitudeKind::List, None) => {
                Err("attitudes of the kind list need a file: attitudes = { kind = \"list\", file = \"attitudes.csv\" }".to_owned())
            }
            (_, Some(_)) => Err("attitudes.file is read by the kind list alone; leave it out, or write kind = \"list\"".to_owned()),
            (_, None) => Ok(Vec::new()),
        }
    }

    fn requirement(&self, case: &PlannedCase, spanned: &Spanned<RequirementTable>) -> Result<PlannedRequirement, SuiteError> {
        let (table, line) = (spanned.get_ref(), self.lines.line(spanned.span().start));
        let wrong = |message: String| self.wrong(line, message);
        let metric = Metric::find(&table.metric).map_err(&wrong)?;
        let limit = match (table.at_least, table.at_most) {
            (Some(limit), None) => RequirementLimit::AtLeast(limit),
            (None, Some(limit)) => RequirementLimit::AtMost(limit),
            _ => return Err(wrong("a requirement has either at_least or at_most; write one of them".to_owned())),
        };
        if !limit.value().is_finite() {
            return Err(wrong(format!("{} is no limit; give a finite number", limit.value())));
        }
        let confidence = table.confidence.unwrap_or(self.file.confidence);
        Self::confidence(confidence).map_err(&wrong)?;
        let when = match (&table.when, &case.sweep) {
            (None, _) => None,
            (Some(when), None) => return Err(wrong(format!("when = {when:?}, and the case has no sweep; leave it out"))),
            (Some(when), Some(sweep)) => Some(When::parse(when, &sweep.name).map_err(&wrong)?),
        };
        self.check_design(case, &metric, &table.metric).map_err(&wrong)?;
        let fewest = fewest_frames(metric.kind, limit, 1.0 - confidence).unwrap_or(1);
        // Nights, sequences and fields hold several frames each.
        let per_unit = match metric.needs {
            AnswerNeeds::Diagnosis => case.night_frames,
            AnswerNeeds::Camera => {
                if self.file.system.is_none() {
                    case.night_frames
                } else {
                    1
                }
            }
            AnswerNeeds::Sequence => case.attitudes.frames_per_field(),
            _ if metric.counts_frames_alone() => 1,
            _ => case.attitudes.frames_per_unit(),
        };
        let (needed, given) = (fewest * per_unit, case.frames.unwrap_or(case.max_frames));
        if needed > given && table.level == RequirementLevel::Minimum {
            let key = if case.frames.is_some() { "frames" } else { "max_frames" };
            let number = limit.value();
            return Err(wrong(format!(
                "{} {} {number} cannot be shown at a confidence of {confidence} by {given} frames: without a single failure it takes {needed}; \
                 set {key} = {needed} or more, or frames = \"auto\" with max_frames = {needed} or more",
                table.metric,
                limit.sign(),
            )));
        }
        Ok(PlannedRequirement { name: table.metric.clone(), metric, limit, confidence, level: table.level, line, when })
    }

    /// Whether frames and system of a case can tell a metric at all.
    fn check_design(&self, case: &PlannedCase, metric: &Metric, name: &str) -> Result<(), String> {
        let kind = case.attitudes.table.kind;
        let given = format!("{kind:?}").to_lowercase();
        let design = |kinds: &[AttitudeKind], words: &str| {
            if kinds.contains(&kind) { Ok(()) } else { Err(format!("{name} needs attitudes = {words}; this case has {given}")) }
        };
        match metric.statistic {
            Statistic::FovSpatial => design(&[AttitudeKind::Nested], "\"nested\"")?,
            Statistic::PixelSpatial => design(&[AttitudeKind::Nested, AttitudeKind::Dither], "\"nested\" or \"dither\"")?,
            Statistic::TemporalNoise => {
                design(&[AttitudeKind::Nested, AttitudeKind::Dither, AttitudeKind::Stare], "\"nested\", \"dither\" or \"stare\"")?;
            }
            _ => {}
        }
        if metric.needs == AnswerNeeds::Sequence {
            design(&[AttitudeKind::Scan], "\"scan\", which has sequences")?;
        }
        if metric.needs == AnswerNeeds::Diagnosis && (self.file.system.is_some() || !self.file.own.diagnose) {
            return Err(format!("{name} is of boresight's own diagnosis: leave [system] out and write diagnose = true into [own]"));
        }
        Ok(())
    }
}

fn check_numbers(case: &CaseTable, table: &AttitudeTable) -> Result<(), String> {
    let positive =
        |name: &str, value: f64| if value > 0.0 && value.is_finite() { Ok(()) } else { Err(format!("{name} = {value} must be above 0")) };
    positive("within_arcsec", case.within_arcsec)?;
    positive("about_within_arcsec", case.about_within_arcsec.unwrap_or(1.0))?;
    positive("attitudes.step_px", table.step_px)?;
    for (name, count) in [
        ("max_frames", case.max_frames),
        ("night_frames", case.night_frames),
        ("attitudes.repeats", table.repeats),
        ("attitudes.sequence", table.sequence),
    ] {
        if count == 0 {
            return Err(format!("{name} = 0 must be at least 1"));
        }
    }
    if !(1..=100).contains(&table.grid) {
        return Err(format!("attitudes.grid = {} must be from 1 to 100", table.grid));
    }
    if table.kind == AttitudeKind::Nested && (table.grid < 2 || table.repeats < 2) {
        return Err("attitudes of the kind nested tell causes apart by at least 2 places (grid) and 2 repeats".to_owned());
    }
    Ok(())
}

fn planned_sweep(sweep: &super::suite_file::SweepTable) -> Result<PlannedSweep, String> {
    if sweep.values.is_empty() {
        return Err("sweep.values is empty; give at least one value".to_owned());
    }
    let path = ScenePath::find(&schema(), &dotted(&sweep.path)).map_err(|message| format!("sweep.path: {message}"))?;
    let last = sweep.path.rsplit('.').next().unwrap_or_default();
    let name = sweep.name.clone().unwrap_or_else(|| last.split('[').next().unwrap_or(last).to_owned());
    Ok(PlannedSweep { name, path, values: sweep.values.clone() })
}

/// The scene of the first frame: what a case's camera is.
fn first_scene(case: &str, frames_of: &CaseFrames) -> Result<Scene, SuiteError> {
    match frames_of {
        CaseFrames::Scene { path, tables } => {
            let text = with_frames(tables, &[(crate::coordinates::Attitude::from_pointing(0.0, 0.0, 0.0), 0)], false);
            Scene::parse(path, &text).map_err(|source| SuiteError::Scene { case: case.to_owned(), source: Box::new(source) })
        }
        CaseFrames::Dataset(plan) => {
            let key = crate::dataset::FrameKey { split: crate::dataset::DatasetSplit::Test, index: 0 };
            let wrong = |source| SuiteError::Dataset { case: case.to_owned(), source: Box::new(source) };
            plan.frame_scene(key).and_then(|frame| plan.scene_of(&frame)).map_err(wrong)
        }
    }
}
