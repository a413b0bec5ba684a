//! Annotations of lights as COCO, YOLO and SatNet have them. All three count from the corner of the first pixel, so 0.5 is added to places.

use serde_json::{Value, json};

use super::folder::DatasetFile;
use super::sample_labels::{STAR, SampleLabels};

/// What a light is called, in the order of its numbers: COCO's and SatNet's begin at 1, YOLO's at 0.
const CATEGORIES: [&str; 6] = [STAR, "false-star", "satellite", "meteor", "ghost", "cosmic-ray"];
/// The corner of the first pixel, as seen from its centre.
const CORNER_PX: f64 = 0.5;

fn category(kind: &str) -> usize {
    CATEGORIES.iter().position(|known| *known == kind).unwrap_or(0)
}

/// Lights that are annotated: those that are visible.
fn visible(labels: &SampleLabels) -> impl Iterator<Item = usize> + '_ {
    (0..labels.lights.hip.len()).filter(|index| labels.lights.visible[*index])
}

/// Left, top, width and height of the box of a light, from the corner of the first pixel.
fn box_px(labels: &SampleLabels, index: usize) -> [f64; 4] {
    let lights = &labels.lights;
    let (left, top) = (lights.box_left_px[index] as f64, lights.box_top_px[index] as f64);
    // The pixels from the first to the last, both included.
    [left, top, lights.box_right_px[index] as f64 + 1.0 - left, lights.box_bottom_px[index] as f64 + 1.0 - top]
}

fn coco_categories() -> Value {
    let of = |(number, name): (usize, &&str)| json!({"id": number + 1, "name": name, "supercategory": "light", "keypoints": ["centre"], "skeleton": []});
    Value::Array(CATEGORIES.iter().enumerate().map(of).collect())
}

/// What all files of annotations share.
pub(super) fn coco_head(dataset: &DatasetFile) -> Value {
    json!({
        "info": {"description": dataset.name, "version": dataset.version, "contributor": "boresight"},
        "licenses": [{"id": 1, "name": dataset.licence, "url": ""}],
        "categories": coco_categories(),
    })
}

/// The annotations of a shard.
#[derive(Debug, Default)]
pub(super) struct CocoShard {
    images: Vec<Value>,
    annotations: Vec<Value>,
}

impl CocoShard {
    /// Adds a frame, and says how many lights it has. Numbers of annotations are those of frame and light: unique over all shards.
    pub(super) fn add(&mut self, split: &str, labels: &SampleLabels) -> u64 {
        const LIGHTS_OF_A_FRAME: u64 = 1_000_000;
        let [width_px, height_px] = labels.size_px;
        let key = labels.key;
        self.images
            .push(json!({"id": key, "file_name": format!("{split}/{key:09}.png"), "width": width_px, "height": height_px, "license": 1}));
        let lights = &labels.lights;
        let before = self.annotations.len();
        for index in visible(labels) {
            let own = box_px(labels, index);
            self.annotations.push(json!({
                "id": key * LIGHTS_OF_A_FRAME + index as u64,
                "image_id": key,
                "category_id": category(&lights.kind[index]) + 1,
                "bbox": own,
                "area": own[2] * own[3],
                "iscrowd": 0,
                "keypoints": [lights.x_px[index] + CORNER_PX, lights.y_px[index] + CORNER_PX, 2],
                "num_keypoints": 1,
                "hip": lights.hip[index],
                "magnitude": lights.magnitude[index],
                "snr": lights.snr[index],
            }));
        }
        (self.annotations.len() - before) as u64
    }

    /// The file.
    pub(super) fn object(self, dataset: &DatasetFile) -> Value {
        let mut object = coco_head(dataset);
        object["images"] = Value::Array(self.images);
        object["annotations"] = Value::Array(self.annotations);
        object
    }
}

/// `data.yaml` of YOLO.
pub(super) fn yolo_head(dataset: &DatasetFile) -> String {
    let mut text = "path: .\n".to_owned();
    for split in &dataset.splits {
        let key = if split.name == "validation" { "val" } else { &split.name };
        text += &format!("{key}: images/{}\n", split.name);
    }
    text += "names:\n";
    for (number, name) in CATEGORIES.iter().enumerate() {
        text += &format!("  {number}: {name}\n");
    }
    text
}

/// The lines of a frame: number of the kind, centre and sides of the box in parts of the frame; and how many they are.
pub(super) fn yolo_lines(labels: &SampleLabels) -> (String, u64) {
    let [width_px, height_px] = labels.size_px.map(|side| side as f64);
    let (mut text, mut count) = (String::new(), 0);
    for index in visible(labels) {
        let [left, top, width, height] = box_px(labels, index);
        text += &format!(
            "{} {:.6} {:.6} {:.6} {:.6}\n",
            category(&labels.lights.kind[index]),
            (left + 0.5 * width) / width_px,
            (top + 0.5 * height) / height_px,
            width / width_px,
            height / height_px
        );
        count += 1;
    }
    (text, count)
}

/// The annotation of a frame as SatSim writes it (`satsim/io/satnet.py`, `set_frame_annotation`): places in parts of the frame from its corner; the box spans
/// start, middle and end.
pub(super) fn satnet(name: &str, labels: &SampleLabels) -> (Value, u64) {
    let lights = &labels.lights;
    let [width_px, height_px] = labels.size_px;
    let part = |at: f64, side: usize| (at + CORNER_PX) / side as f64;
    let mut objects = Vec::new();
    for index in visible(labels) {
        let x = [lights.x_start_px[index], lights.x_mid_px[index], lights.x_end_px[index]].map(|at| part(at, width_px));
        let y = [lights.y_start_px[index], lights.y_mid_px[index], lights.y_end_px[index]].map(|at| part(at, height_px));
        let ends = |parts: [f64; 3]| (parts.into_iter().fold(f64::INFINITY, f64::min), parts.into_iter().fold(f64::NEG_INFINITY, f64::max));
        let ((x_min, x_max), (y_min, y_max)) = (ends(x), ends(y));
        // Their numbers: a satellite is 1, a star 2.
        let (class, number) = if lights.kind[index] == STAR { ("Star", 2) } else { ("Satellite", 1) };
        objects.push(json!({
            "class_name": class, "class_id": number,
            "y_min": y_min, "x_min": x_min, "y_max": y_max, "x_max": x_max,
            "y_center": part(lights.y_px[index], height_px), "x_center": part(lights.x_px[index], width_px),
            "bbox_height": y_max - y_min, "bbox_width": x_max - x_min,
            "source": "boresight",
            "magnitude": lights.magnitude[index],
            "pe_per_sec": lights.electrons_asked[index] / labels.exposure_s,
            "y_start": y[0], "x_start": x[0], "y_mid": y[1], "x_mid": x[1], "y_end": y[2], "x_end": x[2],
            "seg_id": -1,
            "object_name": lights.kind[index], "object_id": lights.hip[index].to_string(),
            "snr": lights.snr[index],
        }));
    }
    let pixel_deg = (1.0 / labels.focal_length_px).atan().to_degrees();
    let count = objects.len() as u64;
    let object = json!({"data": {
        "file": {"dirname": name, "filename": format!("{:09}.fits", labels.key), "sequence": labels.recording, "sequence_id": labels.key},
        "sensor": {"height": height_px, "width": width_px, "iFOVy": pixel_deg, "iFOVx": pixel_deg},
        "stats": {"num_obs_initial": count, "num_obs": count},
        "metadata": {"time_utc": labels.time_utc, "exposure_s": labels.exposure_s},
        "objects": objects,
    }});
    (object, count)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::catalog::Catalog;
    use crate::dataset::frame_key::{DatasetSplit, FrameKey};
    use crate::dataset::plan::tests::{SCENE, plan_of, recipe};
    use crate::render::PsfTables;

    #[test]
    fn places_count_from_the_corner_in_every_form() {
        let plan = plan_of(&recipe("[hard]\nfalse_stars = { share = 1.0, count = [2, 2] }\n"), SCENE).unwrap();
        let sample = plan.sample(Catalog::embedded(), &PsfTables::default(), FrameKey { split: DatasetSplit::Train, index: 1 }).unwrap();
        let (labels, lights) = (&sample.labels, &sample.labels.lights);
        let first = visible(labels).next().unwrap();
        let mut coco = CocoShard::default();
        let count = coco.add("train", labels);
        assert_eq!(count, lights.visible.iter().filter(|is_visible| **is_visible).count() as u64);
        let own = &coco.annotations[0];
        assert_eq!(own["keypoints"], json!([lights.x_px[first] + 0.5, lights.y_px[first] + 0.5, 2]));
        let [left, top, width, height] = [0, 1, 2, 3].map(|place| own["bbox"][place].as_f64().unwrap());
        assert!(left < lights.x_px[first] + 0.5 && lights.x_px[first] + 0.5 < left + width);
        assert!(top < lights.y_px[first] + 0.5 && lights.y_px[first] + 0.5 < top + height);
        let (lines, yolo_count) = yolo_lines(labels);
        let numbers: Vec<f64> = lines.lines().next().unwrap().split(' ').map(|word| word.parse().unwrap()).collect();
        assert!((numbers[1] * 64.0 - (left + 0.5 * width)).abs() < 1e-4 && (numbers[4] * 48.0 - height).abs() < 1e-4, "{numbers:?}");
        let (object, satnet_count) = satnet("small", labels);
        let star = &object["data"]["objects"][0];
        assert!((star["x_center"].as_f64().unwrap() * 64.0 - 0.5 - lights.x_px[first]).abs() < 1e-9);
        assert_eq!((yolo_count, satnet_count, &star["class_name"]), (count, count, &json!("Star")));
        assert_eq!(category("false-star"), 1);
    }
}
