//! `boresight dataset export`: other programs' forms hold the same frames and lights.

use parquet::file::reader::{FileReader, SerializedFileReader};
use serde_json::Value;

use crate::cli::{run, text};
use crate::dataset_verify::MADE;

fn exported(to: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let set = MADE.path().join("set");
    let ran = run(&["dataset", "export", text(&set), "--to", to, "-o", text(&folder.path().join("out"))]);
    assert_eq!(ran.code, 0, "{to}: {}", ran.stderr);
    assert!(ran.stdout.contains("12 frames with "), "{}", ran.stdout);
    folder
}

fn json(path: &std::path::Path) -> Value {
    serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

#[test]
fn every_form_has_every_frame_and_places_from_the_corner() {
    let one = tempfile::tempdir().unwrap();
    let recipe = MADE.path().join("recipe.toml");
    assert_eq!(run(&["dataset", text(&recipe), "--frame", "5", "-o", text(one.path())]).code, 0);
    let labels = json(&one.path().join("000000005.json"));
    let lights = &labels["lights"];
    let visible: Vec<usize> = (0..lights["hip"].as_array().unwrap().len()).filter(|index| lights["visible"][*index] == true).collect();
    let x_px = |index: usize| lights["x_px"][index].as_f64().unwrap();

    let coco = exported("coco");
    let out = coco.path().join("out");
    let shard = json(&out.join("annotations/train-000001.json"));
    assert_eq!(shard["images"].as_array().unwrap().len(), 4);
    let own: Vec<&Value> = shard["annotations"].as_array().unwrap().iter().filter(|one| one["image_id"] == 5).collect();
    assert_eq!(own.len(), visible.len());
    assert_eq!(own[0]["keypoints"][0].as_f64().unwrap(), x_px(visible[0]) + 0.5);
    let file = shard["images"][1]["file_name"].as_str().unwrap();
    let picture = |path: &std::path::Path| image::open(path).unwrap().into_luma16().into_raw();
    let image = picture(&one.path().join("000000005.image.png"));
    assert_eq!(picture(&out.join("images").join(file)), image);
    let again = run(&["dataset", "export", text(&MADE.path().join("set")), "--to", "coco", "-o", text(&out)]);
    assert!(again.code == 1 && again.stderr.contains("--force"), "{}", again.stderr);

    let yolo = exported("yolo");
    let lines = std::fs::read_to_string(yolo.path().join("out/labels/train/000000005.txt")).unwrap();
    assert_eq!(lines.lines().count(), visible.len());
    assert!(
        std::fs::read_to_string(yolo.path().join("out/data.yaml"))
            .unwrap()
            .contains("train: images/train\ntest: images/test\nnames:\n  0: star\n")
    );

    for (to, fits, annotation) in [
        ("fits", "train/000000005.fits", "train/000000005.json"),
        ("satnet", "train/ImageFiles/000000005.fits", "train/Annotations/000000005.json"),
    ] {
        let folder = exported(to);
        let read = boresight::recording::load_image(&folder.path().join("out").join(fits)).unwrap();
        assert!(read.pixels_dn.iter().zip(&image).all(|(read, own)| *read == f32::from(*own)), "{to}");
        let object = json(&folder.path().join("out").join(annotation));
        if to == "fits" {
            assert_eq!(object, labels);
        } else {
            let star = &object["data"]["objects"][0];
            assert!((star["x_center"].as_f64().unwrap() * 160.0 - 0.5 - x_px(visible[0])).abs() < 1e-9);
            assert_eq!((&star["class_name"], &star["class_id"]), (&Value::from("Star"), &Value::from(2)));
        }
    }

    let table = exported("parquet");
    let file = std::fs::File::open(table.path().join("out/data/train-000001.parquet")).unwrap();
    let reader = SerializedFileReader::new(file).unwrap();
    let about = reader.metadata().file_metadata().key_value_metadata().unwrap();
    assert!(about.iter().any(|one| one.key == "huggingface" && one.value.as_deref().unwrap().contains("\"image\":{\"_type\":\"Image\"}")));
    let row = reader.get_row_iter(None).unwrap().nth(1).unwrap().unwrap();
    let (_, image_field) = row.get_column_iter().next().unwrap();
    let parquet::record::Field::Group(parts) = image_field else { panic!("{image_field:?}") };
    let bytes = parts.get_column_iter().next().unwrap().1;
    let parquet::record::Field::Bytes(bytes) = bytes else { panic!("{bytes:?}") };
    assert_eq!(bytes.data(), std::fs::read(one.path().join("000000005.image.png")).unwrap());
    // A row for each light, by the key of its frame.
    let stars = SerializedFileReader::new(std::fs::File::open(table.path().join("out/stars/train-000001.parquet")).unwrap()).unwrap();
    let key = |row: &parquet::record::Row| row.get_column_iter().find(|(name, _)| *name == "key").unwrap().1.clone();
    let of_frame = stars.get_row_iter(None).unwrap().map(Result::unwrap).filter(|row| key(row) == parquet::record::Field::Long(5)).count();
    let labels: Value = serde_json::from_slice(&std::fs::read(one.path().join("000000005.json")).unwrap()).unwrap();
    assert_eq!(of_frame, labels["lights"]["hip"].as_array().unwrap().len());
}
