//! What pictures show, in numbers and words. Whether a build can draw it is another matter: [`super::drawing`] does.

/// What a mark says of its star image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MarkKind {
    /// Detected, and no catalogue star is known for it.
    Detected,
    /// Identified.
    Identified,
    /// Identified, and rejected by the calibration or known to be wrong.
    Rejected,
    /// A true star that an answer has.
    Answered,
    /// A true star that an answer lacks.
    Unanswered,
    /// A place of an answer where no star is.
    Starless,
}

/// A mark on a frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Mark {
    /// Column.
    pub x_px: f64,
    /// Row.
    pub y_px: f64,
    /// Name of the star.
    pub label: Option<String>,
    /// What to draw.
    pub kind: MarkKind,
}

/// Lines that belong together under one name, as a constellation's do; on the frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Figure {
    /// Its name.
    pub name: String,
    /// Its lines, each a chain of places so near each other that a straight piece joins them: (column, row).
    pub chains: Vec<Vec<[f64; 2]>>,
}

/// A residual: measured minus model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Vector {
    /// Column of the measured point.
    pub x_px: f64,
    /// Row of the measured point.
    pub y_px: f64,
    /// Residual along x.
    pub dx_px: f64,
    /// Residual along y.
    pub dy_px: f64,
    /// Whether the point was rejected.
    pub rejected: bool,
}

/// The residuals of one calibration.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct VectorPanel {
    /// What they are residuals of.
    pub title: String,
    /// The residuals; those that are not finite are left out and counted.
    pub vectors: Vec<Vector>,
    /// What the result itself says of them: a picture and a page that differ in a digit are two answers.
    pub told: Option<FitNumbers>,
}

/// Numbers of a result that stand above its residuals.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FitNumbers {
    /// 2-D rms.
    pub rms_px: f64,
    /// Star images used.
    pub stars: usize,
    /// Star images rejected, those without a finite residual too.
    pub rejected: usize,
}

/// A field over the frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FieldMap {
    /// What it shows.
    pub title: String,
    /// The numbers that matter, below the title.
    pub summary: String,
    /// The values on `side` × `side` pixels, evenly from the centre of the first pixel to that of the last, row by row.
    pub values: Vec<f64>,
    /// Points along each side; at least two.
    pub side: usize,
    /// Values that the colours reach in any case.
    pub reach: Vec<f64>,
    /// What stands above the bar: the unit of the values.
    pub unit: String,
    /// A second unit on the other side of the bar, and how much of it one of the first is.
    pub second_unit: Option<(String, f64)>,
    /// Points to be marked, column and row.
    pub dots: Vec<[f64; 2]>,
    /// Arrows, each centred on its point, all enlarged by one round factor that is written below.
    pub arrows: Vec<Vector>,
    /// Whether they are lines without a head, of a direction that has no sense (an elongation), and their unit then.
    pub whiskers: Option<String>,
    /// What is written below.
    pub note: String,
}

/// One bin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ProfilePoint {
    /// Mean of what the residuals are held against.
    pub at: f64,
    /// Mean of the data.
    pub mean: f64,
    /// Standard error of that mean.
    pub sigma: f64,
    /// The model's mean.
    pub model: f64,
    /// Star images, or whatever else is counted, in it.
    pub stars: usize,
}

/// Residuals in bins and a model.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ProfilePlot {
    /// What it shows.
    pub title: String,
    /// The numbers that matter, below the title.
    pub summary: String,
    /// Name and unit of the horizontal axis.
    pub x_label: String,
    /// Name and unit of the vertical axis.
    pub y_label: String,
    /// What a point is, for the legend.
    pub points: String,
    /// What each bin holds so many of, above the counts.
    pub counted: String,
    /// The bins; those that are not finite are left out.
    pub bins: Vec<ProfilePoint>,
}

/// How a series is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SeriesStyle {
    /// A dot for each point.
    Points,
    /// A line through the points, in their order.
    Line,
}

/// Points that belong together.
#[derive(Clone, Debug, PartialEq)]
pub struct Series {
    /// Its name in the legend; empty: none.
    pub label: String,
    /// How it is drawn.
    pub style: SeriesStyle,
    /// The points, in the units of the axes; those that are not finite are left out.
    pub points: Vec<[f64; 2]>,
}

/// A plot.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Plot {
    /// What it shows.
    pub title: String,
    /// Name and unit of the horizontal axis.
    pub x_label: String,
    /// Name and unit of the vertical axis.
    pub y_label: String,
    /// The series; the first ones lie below.
    pub series: Vec<Series>,
}

/// What became of a hypothesis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RankKind {
    /// It is a finding.
    Found,
    /// It cannot be told apart from a finding.
    InSet,
    /// It stands out, but its name does not stand.
    Withheld,
    /// It was tested and is no finding.
    Tested,
}

/// A hypothesis.
#[derive(Clone, Debug, PartialEq)]
pub struct Rank {
    /// Its name.
    pub label: String,
    /// How far it stands out: the standard deviations of a normal number that chance makes as rarely.
    pub deviations: f64,
    /// What became of it.
    pub kind: RankKind,
}

/// Hypotheses by significance.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Ranking {
    /// What it shows.
    pub title: String,
    /// What stands below the title.
    pub summary: String,
    /// The hypotheses in any order; those without a number are left out.
    pub ranks: Vec<Rank>,
    /// A finding needs so many standard deviations.
    pub threshold: Option<f64>,
}

/// Two frames of the same size.
#[derive(Clone, Debug, PartialEq)]
pub struct OffOn {
    /// What is switched on.
    pub title: String,
    /// Its parameters, below the title.
    pub summary: String,
    /// Columns and rows.
    pub frame_px: (usize, usize),
    /// Counts without it, row by row.
    pub off_dn: Vec<f32>,
    /// Counts with it.
    pub on_dn: Vec<f32>,
}

impl OffOn {
    /// The largest change of a pixel, DN.
    #[must_use]
    pub fn largest_dn(&self) -> f32 {
        self.on_dn.iter().zip(&self.off_dn).map(|(on, off)| (on - off).abs()).fold(0.0, f32::max)
    }
}
