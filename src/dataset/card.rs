//! README.md of a dataset: the head in YAML that Hugging Face reads, then what it is in words.

use serde_json::Value;

use super::folder::DatasetFile;
use super::plan::CPU;
use super::recipe::{ImageFormat, SampleMember};
use super::sample_labels::SampleLabels;
use super::whole_dataset::WholeDataset;

/// The card.
pub(super) fn card(whole: &WholeDataset<'_>) -> String {
    let dataset = whole.file;
    let mut text = head(dataset);
    text += &format!("# {}\n\n", dataset.name);
    let (on, option) = if dataset.backend == CPU { ("the CPU", "") } else { (dataset.backend.as_str(), " --backend gpu") };
    text += &format!(
        "{} labelled frames of a star camera, simulated by boresight {} on {on} from `recipe.toml` (seed {}).\n\
         Every frame follows from recipe and number alone, and can be made again:\n\
         `boresight dataset recipe.toml --frame NUMBER{option} -o DIR`.\n\n",
        dataset.frames(),
        dataset.version,
        dataset.seed
    );
    text += &splits(whole);
    text += &contents(dataset, whole.marks.iter().any(|(_, mark)| !mark.tables.is_empty()));
    text += CONVENTIONS;
    text += &loaders(dataset);
    text += &format!(
        "\n## Where it is from\n\n\
         - Stars: {} (SHA-256 `{}`).\n- Recipe, scene, catalogue and version of the program together: `{}`.\n- `boresight dataset verify DIR` holds \
         the labels against the pixels and makes frames again.\n\n\
         ## What it lacks of real frames\n\n\
         The frames have what the scene states, and nothing else: no cloud, no aircraft, no fault of the electronics that is not an effect of the recipe. \
         Stars are those of the catalogue, down to its faintest. A network that is trained here alone should be judged on real frames.\n",
        dataset.catalog, dataset.catalog_sha256, dataset.recipe_sha256
    );
    text
}

/// The licence as the Hub writes it.
fn licence(dataset: &DatasetFile) -> String {
    if dataset.licence.is_empty() { "unknown".to_owned() } else { dataset.licence.to_lowercase() }
}

fn size_category(frames: u64) -> &'static str {
    match frames {
        0..1_000 => "n<1K",
        1_000..10_000 => "1K<n<10K",
        10_000..100_000 => "10K<n<100K",
        100_000..1_000_000 => "100K<n<1M",
        1_000_000..10_000_000 => "1M<n<10M",
        _ => "10M<n<100M",
    }
}

fn head(dataset: &DatasetFile) -> String {
    let mut text = format!(
        "---\nlicense: {}\npretty_name: {}\nsize_categories:\n- {}\ntask_categories:\n- object-detection\n- image-segmentation\n\
         tags:\n- astronomy\n- star-tracker\n- synthetic\n- webdataset\nconfigs:\n",
        licence(dataset),
        dataset.name,
        size_category(dataset.frames())
    );
    // Tables are no configurations of their own: `datasets` reads all of a repository as one form.
    text += "- config_name: default\n  data_files:\n";
    for split in &dataset.splits {
        text += &format!("  - split: {0}\n    path: {0}/*.tar\n", split.name);
    }
    text + &features(dataset) + "---\n\n"
}

/// What a sample consists of, as Hugging Face `datasets` has it. Without it the types are guessed from the first samples, which may have no stars.
fn features(dataset: &DatasetFile) -> String {
    // Arrays of NumPy and FITS files have no such type.
    if dataset.image != ImageFormat::Png16 || dataset.members.contains(&SampleMember::Clean) {
        return String::new();
    }
    let mut text =
        "dataset_info:\n- config_name: default\n  features:\n  - name: __key__\n    dtype: string\n  - name: __url__\n    dtype: string\n"
            .to_owned();
    let image = |name: &str| format!("  - name: {name}\n    dtype: image\n");
    if dataset.members.contains(&SampleMember::Distance) {
        text += &image("distance.png");
    }
    text += &image("image.png");
    if dataset.members.contains(&SampleMember::Instances) {
        text += &image("instances.png");
    }
    let schema = schemars::schema_for!(SampleLabels).to_value();
    text += "  - name: json\n    struct:\n";
    text += &structure(&schema, &schema, "    ");
    if dataset.members.contains(&SampleMember::Mask) {
        text += &image("mask.png");
    }
    text
}

/// The fields of an object of a schema.
fn structure(root: &Value, node: &Value, indent: &str) -> String {
    let mut text = String::new();
    for (name, field) in node.get("properties").and_then(Value::as_object).into_iter().flatten() {
        text += &format!("{indent}- name: {name}\n");
        let target = field.get("$ref").and_then(Value::as_str).and_then(|target| root.pointer(target.trim_start_matches('#')));
        if let Some(target) = target.filter(|target| target.get("properties").is_some()) {
            text += &format!("{indent}  struct:\n{}", structure(root, target, &format!("{indent}  ")));
        } else if let Some(items) = field.get("items").filter(|_| field.get("type").is_some_and(|kind| kind == "array")) {
            text += &format!("{indent}  list: {}\n", dtype(items));
        } else {
            text += &format!("{indent}  dtype: {}\n", dtype(field));
        }
    }
    text
}

fn dtype(field: &Value) -> &'static str {
    match field.get("type").and_then(Value::as_str) {
        Some("integer") => "int64",
        Some("number") => "float64",
        Some("boolean") => "bool",
        _ => "string",
    }
}

/// Splits and what they share.
fn splits(whole: &WholeDataset<'_>) -> String {
    let dataset = whole.file;
    let mut text = "## Splits\n\n| split | frames | shards | cameras | share of the sky | visible stars | frames without any | bytes |\n\
                    |---|---|---|---|---|---|---|---|\n"
        .to_owned();
    for split in &dataset.splits {
        let own = whole.marks.iter().filter(|(shard, _)| shard.split.name() == split.name).map(|(_, mark)| mark);
        let (mut stars, mut none, mut bytes) = (0, 0, 0);
        for mark in own {
            stars += mark.statistics.stars_by_magnitude.iter().sum::<u64>();
            none += mark.statistics.frames_by_stars.first().copied().unwrap_or_default();
            bytes += mark.bytes + mark.tables.iter().map(|table| table.bytes).sum::<u64>();
        }
        text += &format!(
            "| {} | {} | {} of {} | {} | {} | {stars} | {none} | {bytes} |\n",
            split.name,
            split.frames,
            split.shards,
            dataset.frames_per_shard,
            split.cameras,
            split.sky()
        );
    }
    if !dataset.leaks.is_empty() {
        text += "\nWhat they share:\n\n| splits | nearest boresights | nearest times | shared cameras | shared seeds | shared stars |\n|---|---|---|---|---|---|\n";
        for leak in &dataset.leaks {
            let [a, b] = &leak.splits;
            let nearest = leak.nearest_boresights_deg.map_or_else(|| "not known".to_owned(), |angle| format!("{angle:.2}°"));
            let stars = leak.shared_stars.map_or_else(|| "not known".to_owned(), |share| format!("{:.2} %", 100.0 * share));
            let epochs = leak.nearest_epochs_s.map_or_else(|| "not known".to_owned(), |seconds| format!("{seconds} s"));
            text += &format!("| {a}, {b} | {nearest} | {epochs} | {} | {} | {stars} |\n", leak.shared_cameras, leak.shared_seeds);
        }
        text += "\nBoresights, times, seeds and stars of at most the first 20,000 frames of each split.\n";
    }
    text
}

/// The files.
fn contents(dataset: &DatasetFile, has_tables: bool) -> String {
    let image = match dataset.image {
        ImageFormat::Png16 => "| `KEY.image.png` | the frame, PNG of 16 bits: counts |\n",
        ImageFormat::Npy => "| `KEY.image.npy` | the frame, NumPy array of uint16: counts |\n",
        ImageFormat::FitsRice => "| `KEY.image.fits` | the frame, FITS packed without loss (Rice, second unit of the file): counts |\n",
    };
    let mut text = format!(
        "\n## Files\n\nA shard (`SPLIT/NNNNNN.tar`) is a tar archive, the form of WebDataset. KEY is the number of the frame, nine digits. A sample is\n\n\
         | file | content |\n|---|---|\n{image}| `KEY.json` | labels of the frame and, column by column, of every light on it |\n"
    );
    for member in &dataset.members {
        text += match member {
            SampleMember::Mask => "| `KEY.mask.png` | what each pixel shows, 8 bits, see below |\n",
            SampleMember::Distance => {
                "| `KEY.distance.png` | distance of each pixel to the nearest visible star, in eighths of a pixel; 255: 31.875 px or more |\n"
            }
            SampleMember::Instances => {
                "| `KEY.instances.png` | the light of the labels that each pixel shows, counted from 1; 0: none; 16 bits |\n"
            }
            SampleMember::Clean => "| `KEY.clean.npy` | expected electrons without noise, NumPy array of float32 |\n",
        };
    }
    if has_tables {
        text += "\nThe same labels are tables: `tables/SPLIT/NNNNNN.frames.parquet` has a row for each frame, `NNNNNN.stars.parquet` one for each light, with the \
                 `key` of its frame.\n";
    }
    text += "`statistics.html` shows what was drawn, `croissant.json` describes the files for machines, `SHA256SUMS` has the hash of each \
             (`sha256sum -c SHA256SUMS`).\n";
    if dataset.members.contains(&SampleMember::Mask) {
        text += "\n| value of the mask | name | meaning |\n|---|---|---|\n";
        for (value, class) in dataset.pixel_classes.iter().enumerate() {
            text += &format!("| {value} | {} | {} |\n", class.name, class.meaning);
        }
    }
    text
}

const CONVENTIONS: &str = "\n## Conventions\n\n\
- (0, 0) is the CENTRE of the first pixel; x grows to the right (columns), y downwards (rows). A program that counts from the corner of the first pixel adds 0.5.\n\
- Camera axes: x right, y down, z along the boresight. Quaternions are `camera_from_icrs`, scalar last.\n\
- Units stand in names. `crlb_x_px` and `crlb_y_px` are the least standard errors that the noise allows (Cramér–Rao bound): weights for a loss, and the aim of a network.\n\
- `visible`: the light is 5 or more times its standard error, and its centre is on the frame. Labels also hold fainter stars.\n\
- `kind` is `star` for stars of the catalogue; all other lights are none.\n";

/// A few lines for each library.
fn loaders(dataset: &DatasetFile) -> String {
    let split = dataset.splits.first().map_or("train", |split| split.name.as_str());
    let shards = dataset.splits.first().map_or(0, |split| split.shards.saturating_sub(1));
    let (name, decode) = match dataset.image {
        ImageFormat::Png16 => (
            "image.png",
            "np.asarray(Image.open(io.BytesIO(sample[\"image.png\"]))).astype(np.float32)  # decode(\"pil\") would cut 16 bits to 8",
        ),
        ImageFormat::Npy => ("image.npy", "np.load(io.BytesIO(sample[\"image.npy\"])).astype(np.float32)"),
        ImageFormat::FitsRice => ("image.fits", "fits.getdata(io.BytesIO(sample[\"image.fits\"]), 1).astype(np.float32)"),
    };
    let import = match dataset.image {
        ImageFormat::Png16 => "import io, json, numpy as np\nfrom PIL import Image",
        ImageFormat::Npy => "import io, json, numpy as np",
        ImageFormat::FitsRice => "import io, json, numpy as np\nfrom astropy.io import fits",
    };
    format!(
        "\n## Loading\n\nwebdataset (and PyTorch's `DataLoader`, with at most as many workers as there are shards):\n\n```python\n{import}\nimport webdataset as wds\n\
         for sample in wds.WebDataset(\"{split}/{{000000..{shards:06}}}.tar\", shardshuffle=False):\n    image = {decode}\n    \
         stars = json.loads(sample[\"json\"])[\"lights\"]\n```\n\n\
         Hugging Face `datasets` and `polars`:\n\n```python\nfrom datasets import load_dataset\n\
         frames = load_dataset(\"DIR\", split=\"{split}\", streaming=True)   # each has {name} and json\n\
         table = load_dataset(\"parquet\", data_files=\"DIR/tables/{split}/*.frames.parquet\", split=\"train\")\n\
         import polars as pl\nstars = pl.read_parquet(\"DIR/tables/{split}/*.stars.parquet\")\n```\n"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_head_names_every_label_with_its_type() {
        let schema = schemars::schema_for!(SampleLabels).to_value();
        let text = structure(&schema, &schema, "");
        for lines in [
            "- name: key\n  dtype: int64\n",
            "- name: camera_from_icrs_mid\n  list: float64\n",
            "- name: effects\n  list: string\n",
            "- name: no_stars\n  dtype: bool\n",
            "- name: lights\n  struct:\n  - name: hip\n    list: int64\n  - name: kind\n    list: string\n  - name: x_px\n    list: float64\n",
            "  - name: visible\n    list: bool\n",
        ] {
            assert!(text.contains(lines), "{lines} is not in\n{text}");
        }
        assert_eq!([999, 1000, 200_960].map(size_category), ["n<1K", "1K<n<10K", "100K<n<1M"]);
    }
}
