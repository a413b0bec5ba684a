//! What of a scene can be switched off by itself, so that a failure shows what it needs.

use toml::{Table, Value};

/// Something that can be taken out of a scene.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Switch {
    /// In words.
    pub(super) name: String,
    what: What,
}

#[derive(Clone, Debug, PartialEq, Eq)]
enum What {
    Effect(String),
    Table(&'static str),
    /// A key of a table, and the value that means none; `None`: it is removed.
    Key(&'static str, &'static str, Option<i64>),
    /// A key of every exposure.
    OfFrames(&'static str),
}

const TABLES: [(&str, &str); 5] = [
    ("jitter", "jitter"),
    ("cosmic_rays", "cosmic rays"),
    ("ghosts", "ghosts"),
    ("streaks", "streaks"),
    ("psf", "the shape of the star image"),
];
const KEYS: [(&str, &str, Option<i64>, &str); 13] = [
    ("camera", "line_time_us", None, "rolling shutter"),
    ("camera", "k1", Some(0), "radial distortion"),
    ("camera", "p1", Some(0), "decentring p1"),
    ("camera", "p2", Some(0), "decentring p2"),
    ("camera", "binning", None, "binning"),
    ("detector", "read_noise_e", Some(0), "read noise"),
    ("detector", "full_well_e", None, "saturation of the wells"),
    ("detector", "quantum_efficiency", None, "the curve of the quantum efficiency"),
    ("detector", "colour_filters", None, "colour filters"),
    ("detector", "colour_term_mag_per_mag", None, "the colour term"),
    ("sky", "background_e_per_px_s", Some(0), "light of the sky"),
    ("sky", "background_image", None, "the image of the sky"),
    ("sky", "extinction_mag_per_airmass", None, "extinction"),
];
const OF_FRAMES: [(&str, &str); 2] = [("rate_deg_s", "turning of the camera"), ("temperature_c", "temperature")];

/// All that a scene has switched on.
pub(super) fn switches(scene: &Table) -> Vec<Switch> {
    let mut all = Vec::new();
    let effects = scene.get("effects").and_then(Value::as_array).map_or(&[][..], Vec::as_slice);
    for id in effects.iter().filter_map(|effect| effect.get("id").and_then(Value::as_str)) {
        all.push(Switch { name: id.to_owned(), what: What::Effect(id.to_owned()) });
    }
    for (table, name) in TABLES {
        if scene.contains_key(table) {
            all.push(Switch { name: name.to_owned(), what: What::Table(table) });
        }
    }
    for (table, key, none, name) in KEYS {
        let stands = scene.get(table).and_then(|table| table.get(key));
        let is_none = |value: &Value| value.as_float() == Some(0.0) || value.as_integer() == Some(0);
        if stands.is_some_and(|value| !is_none(value)) {
            all.push(Switch { name: name.to_owned(), what: What::Key(table, key, none) });
        }
    }
    let frames = scene.get("frames").and_then(Value::as_array).map_or(&[][..], Vec::as_slice);
    for (key, name) in OF_FRAMES {
        let of_series = scene.get("series").and_then(|series| series.get(key));
        if of_series.is_some() || frames.iter().any(|frame| frame.get(key).is_some()) {
            all.push(Switch { name: name.to_owned(), what: What::OfFrames(key) });
        }
    }
    all
}

impl Switch {
    /// The scene without it.
    pub(super) fn off(&self, scene: &Table) -> Table {
        let mut scene = scene.clone();
        match &self.what {
            What::Effect(id) => {
                if let Some(Value::Array(effects)) = scene.get_mut("effects") {
                    effects.retain(|effect| effect.get("id").and_then(Value::as_str) != Some(id));
                }
            }
            What::Table(table) => {
                scene.remove(*table);
            }
            What::Key(table, key, none) => {
                if let Some(Value::Table(table)) = scene.get_mut(*table) {
                    match none {
                        Some(none) => table.insert((*key).to_owned(), Value::Float(*none as f64)),
                        None => table.remove(*key),
                    };
                }
            }
            What::OfFrames(key) => {
                if let Some(Value::Table(series)) = scene.get_mut("series") {
                    series.remove(*key);
                }
                if let Some(Value::Array(frames)) = scene.get_mut("frames") {
                    for frame in frames.iter_mut().filter_map(Value::as_table_mut) {
                        frame.remove(*key);
                    }
                }
            }
        }
        scene
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_on_can_be_switched_off_one_by_one() {
        let text = "[camera]\nline_time_us = 30.0\nk1 = 0.0\n[detector]\nread_noise_e = 4\n[jitter]\nsigma_arcsec = [1.0, 1.0, 1.0]\n\
                    [[frames]]\nexposure_s = 1.0\nrate_deg_s = [0.0, 0.0, 1.0]\n[[effects]]\nid = \"prnu\"\n[[effects]]\nid = \"dsnu\"\n";
        let scene: Table = toml::from_str(text).unwrap();
        let all = switches(&scene);
        let names: Vec<&str> = all.iter().map(|own| own.name.as_str()).collect();
        assert_eq!(names, ["prnu", "dsnu", "jitter", "rolling shutter", "read noise", "turning of the camera"]);
        let bare = all.iter().fold(scene, |scene, own| own.off(&scene));
        assert_eq!(switches(&bare), []);
        assert_eq!(bare["frames"][0]["exposure_s"].as_float(), Some(1.0));
    }
}
