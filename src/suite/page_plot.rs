//! Metrics over the values of a sweep, drawn as SVG.

use super::junit::number;
use super::result::{CaseResult, RequirementResult};
use super::verdict::RequirementVerdict;
use crate::dataset::escaped;

const WIDTH: f64 = 460.0;
const HEIGHT: f64 = 230.0;
const LEFT: f64 = 64.0;
const RIGHT: f64 = 16.0;
const TOP: f64 = 28.0;
const BOTTOM: f64 = 40.0;

/// A point of a plot.
struct Point<'r> {
    label: String,
    own: &'r RequirementResult,
}

/// A plot of every metric that is required at two values of a sweep or more.
pub(super) fn sweep_plots(case: &CaseResult) -> String {
    let mut metrics: Vec<&str> = Vec::new();
    for own in case.values.iter().flat_map(|value| &value.requirements) {
        if !metrics.contains(&own.metric.as_str()) {
            metrics.push(&own.metric);
        }
    }
    let Some(sweep) = &case.sweep else { return String::new() };
    let plot = |metric: &&str| {
        let points: Vec<Point<'_>> = case
            .values
            .iter()
            .filter_map(|value| {
                let own = value.requirements.iter().find(|own| own.metric == **metric && own.measured.is_some())?;
                Some(Point { label: value.words.split(" = ").last().unwrap_or_default().to_owned(), own })
            })
            .collect();
        if points.len() < 2 { String::new() } else { plot_of(sweep, metric, &points) }
    };
    metrics.iter().map(plot).collect()
}

fn plot_of(sweep: &str, metric: &str, points: &[Point<'_>]) -> String {
    let numbers = |own: &RequirementResult| {
        let measured = own.measured.as_ref();
        [measured.map(|own| own.value), measured.and_then(|own| own.lower), measured.and_then(|own| own.upper), Some(own.limit.value())]
    };
    let all: Vec<f64> = points.iter().flat_map(|point| numbers(point.own)).flatten().collect();
    let (low, high) = all.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), own| (low.min(*own), high.max(*own)));
    let margin = 0.06 * (high - low).max(1e-9 + 0.01 * high.abs());
    let (low, high) = (low - margin, high + margin);
    let x = |index: usize| LEFT + (WIDTH - LEFT - RIGHT) * (index as f64 + 0.5) / points.len() as f64;
    let y = |value: f64| TOP + (HEIGHT - TOP - BOTTOM) * (high - value) / (high - low);
    let mut svg = format!(
        "<svg viewBox=\"0 0 {WIDTH} {HEIGHT}\" width=\"{WIDTH}\" role=\"img\" aria-label=\"{0} over {1}\" font-family=\"system-ui,sans-serif\" font-size=\"12\">\
         <text x=\"{LEFT}\" y=\"16\" font-weight=\"600\">{0}</text>\
         <rect x=\"{LEFT}\" y=\"{TOP}\" width=\"{2}\" height=\"{3}\" fill=\"none\" stroke=\"#bbb\"/>",
        escaped(metric),
        escaped(sweep),
        WIDTH - LEFT - RIGHT,
        HEIGHT - TOP - BOTTOM
    );
    for step in 0..=3 {
        let value = low + margin + (high - low - 2.0 * margin) * f64::from(step) / 3.0;
        svg += &format!(
            "<text x=\"{}\" y=\"{:.1}\" text-anchor=\"end\" fill=\"#555\">{}</text><line x1=\"{}\" x2=\"{LEFT}\" y1=\"{:.1}\" y2=\"{:.1}\" stroke=\"#bbb\"/>",
            LEFT - 7.0,
            y(value) + 4.0,
            number(value),
            LEFT - 4.0,
            y(value),
            y(value)
        );
    }
    for (index, point) in points.iter().enumerate() {
        let colour = match point.own.verdict {
            RequirementVerdict::Pass => "#2a7f3f",
            RequirementVerdict::Fail => "#b3261e",
            RequirementVerdict::Undecided => "#8a6d00",
        };
        let [value, lower, upper, limit] = numbers(point.own).map(|own| own.unwrap_or(f64::NAN));
        let half = 0.5 * (WIDTH - LEFT - RIGHT) / points.len() as f64;
        let ends = |own: f64, open: f64| if own.is_finite() { y(own) } else { open };
        svg += &format!(
            "<line x1=\"{:.1}\" x2=\"{:.1}\" y1=\"{3:.1}\" y2=\"{3:.1}\" stroke=\"#444\" stroke-dasharray=\"4 3\"/>\
             <line x1=\"{2:.1}\" x2=\"{2:.1}\" y1=\"{4:.1}\" y2=\"{5:.1}\" stroke=\"{colour}\" stroke-width=\"2\"/>\
             <circle cx=\"{2:.1}\" cy=\"{6:.1}\" r=\"4\" fill=\"{colour}\"/>\
             <text x=\"{2:.1}\" y=\"{7:.1}\" text-anchor=\"middle\" fill=\"#555\">{8}</text>",
            x(index) - half,
            x(index) + half,
            x(index),
            y(limit),
            ends(lower, HEIGHT - BOTTOM),
            ends(upper, TOP),
            y(value),
            HEIGHT - BOTTOM + 15.0,
            escaped(&point.label)
        );
    }
    svg += &format!(
        "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text></svg>\n",
        LEFT + (WIDTH - LEFT - RIGHT) / 2.0,
        HEIGHT - 8.0,
        escaped(sweep)
    );
    format!("<figure>{svg}<figcaption>Dots: measured, with one-sided bounds. Dashed: the limit.</figcaption></figure>\n")
}
