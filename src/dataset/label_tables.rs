//! Labels as rows of tables: of frames, and of the lights on them.

use serde_json::Value;

use super::sample_labels::{LightColumns, STAR, SampleLabels};
use super::table_columns::{TableCells, TableColumn};

/// Labels that are lists, with the names of their columns.
const LISTS: [(&str, &[&str]); 8] = [
    ("size_px", &["width_px", "height_px"]),
    ("camera_from_icrs_start", &["start_i", "start_j", "start_k", "start_w"]),
    ("camera_from_icrs_mid", &["mid_i", "mid_j", "mid_k", "mid_w"]),
    ("camera_from_icrs_end", &["end_i", "end_j", "end_k", "end_w"]),
    ("rate_deg_s", &["rate_x_deg_s", "rate_y_deg_s", "rate_z_deg_s"]),
    ("velocity_km_s", &["velocity_x_km_s", "velocity_y_km_s", "velocity_z_km_s"]),
    ("principal_point_px", &["principal_point_x_px", "principal_point_y_px"]),
    ("distortion", &["k1", "p1", "p2"]),
];
/// Labels that are no column of frames: those of lights have a table of their own, and seeds do not fit a signed number everywhere.
const NO_COLUMNS: [&str; 2] = ["format", "lights"];

/// The row of a frame. Empty if the labels cannot be told, which does not happen.
pub(super) fn frame_columns(labels: &mut SampleLabels) -> Vec<TableColumn> {
    // The lights are set aside: there are thousands.
    let lights = std::mem::take(&mut labels.lights);
    let fields = serde_json::to_value(&*labels);
    labels.lights = lights;
    let Ok(Value::Object(fields)) = fields else { return Vec::new() };
    let mut columns = Vec::with_capacity(64);
    for (name, value) in &fields {
        if NO_COLUMNS.contains(&name.as_str()) {
            continue;
        }
        let named = LISTS.iter().find(|(list, _)| list == name);
        match (named, value) {
            (Some((_, names)), Value::Array(items)) => {
                for (name, item) in names.iter().zip(items) {
                    columns.extend(cell(name, item));
                }
            }
            (None, Value::Array(words)) => {
                let words: Vec<&str> = words.iter().filter_map(Value::as_str).collect();
                columns.push(TableColumn::new(name, TableCells::Text(vec![words.join(" ")])));
            }
            (_, value) => columns.extend(cell(name, value)),
        }
    }
    let [ra, dec] = labels.boresight_radec_deg();
    let stars = labels.lights.kind.iter().filter(|kind| *kind == STAR).count();
    let others = labels.lights.kind.len() - stars;
    columns.push(TableColumn::new("boresight_ra_deg", TableCells::Number(vec![ra])));
    columns.push(TableColumn::new("boresight_dec_deg", TableCells::Number(vec![dec])));
    for (name, count) in [("stars", stars), ("visible_stars", labels.lights.visible_stars()), ("other_lights", others)] {
        columns.push(TableColumn::new(name, TableCells::Whole(vec![count.cast_signed() as i64])));
    }
    columns
}

fn cell(name: &str, value: &Value) -> Option<TableColumn> {
    let cells = match value {
        Value::Bool(flag) => TableCells::Flag(vec![*flag]),
        Value::Number(number) if !number.is_f64() => TableCells::Whole(vec![number.as_i64()?]),
        Value::Number(number) => TableCells::Number(vec![number.as_f64()?]),
        Value::String(text) => TableCells::Text(vec![text.clone()]),
        Value::Null | Value::Array(_) | Value::Object(_) => return None,
    };
    Some(TableColumn::new(name, cells))
}

/// The rows of the lights of a frame; `key` is its number.
pub(super) fn light_columns(key: u64, lights: &LightColumns) -> Vec<TableColumn> {
    let mut columns = vec![TableColumn::new("key", TableCells::Whole(vec![key.cast_signed(); lights.hip.len()]))];
    columns.extend(lights.columns().into_iter().map(|(name, cells)| TableColumn::new(name, cells)));
    columns
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::catalog::Catalog;
    use crate::dataset::frame_key::{DatasetSplit, FrameKey};
    use crate::dataset::plan::tests::{SCENE, plan_of, recipe};
    use crate::render::PsfTables;

    #[test]
    fn tables_have_a_column_for_every_label_and_the_same_for_every_frame() {
        let plan = plan_of(&recipe("[hard]\nno_stars = 0.5\n"), SCENE).unwrap();
        let mut shapes = Vec::new();
        for index in 0..4 {
            let sample = plan.sample(Catalog::embedded(), &PsfTables::default(), FrameKey { split: DatasetSplit::Train, index }).unwrap();
            let labels = serde_json::to_value(&sample.labels).unwrap();
            let mut labels_of = sample.labels.clone();
            let (frames, lights) = (frame_columns(&mut labels_of), light_columns(7, &sample.labels.lights));
            assert!(frames.iter().all(|column| column.cells.len() == 1));
            assert!(lights.iter().all(|column| column.cells.len() == sample.labels.lights.hip.len()));
            assert_eq!(labels_of, sample.labels);
            let own = |columns: &[TableColumn]| -> Vec<String> { columns.iter().map(|column| column.name.clone()).collect() };
            for name in labels.as_object().unwrap().keys() {
                let is_there =
                    LISTS.iter().any(|(list, _)| list == name) || NO_COLUMNS.contains(&name.as_str()) || own(&frames).contains(name);
                assert!(is_there, "{name} is no column");
            }
            let listed: usize = LISTS.iter().map(|(_, names)| names.len()).sum();
            assert_eq!(frames.len(), labels.as_object().unwrap().len() - LISTS.len() - NO_COLUMNS.len() + listed + 5);
            for name in labels["lights"].as_object().unwrap().keys() {
                assert!(own(&lights).contains(name), "{name} is no column");
            }
            shapes.push((own(&frames), own(&lights)));
        }
        assert!(shapes.iter().all(|shape| *shape == shapes[0]));
    }
}
