//! `croissant.json`: the dataset for machines, as JSON-LD of the vocabulary Croissant 1.0 (MLCommons, 2024).

use serde_json::{Value, json};

use super::recipe::ImageFormat;
use super::whole_dataset::WholeDataset;

const CONFORMS_TO: &str = "http://mlcommons.org/croissant/1.0";

/// Names of the vocabulary, as its specification lists them.
fn context() -> Value {
    json!({
        "@language": "en",
        "@vocab": "https://schema.org/",
        "citeAs": "cr:citeAs",
        "column": "cr:column",
        "conformsTo": "dct:conformsTo",
        "cr": "http://mlcommons.org/croissant/",
        "rai": "http://mlcommons.org/croissant/RAI/",
        "data": {"@id": "cr:data", "@type": "@json"},
        "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
        "dct": "http://purl.org/dc/terms/",
        "equivalentProperty": "cr:equivalentProperty",
        "examples": {"@id": "cr:examples", "@type": "@json"},
        "extract": "cr:extract",
        "field": "cr:field",
        "fileProperty": "cr:fileProperty",
        "fileObject": "cr:fileObject",
        "fileSet": "cr:fileSet",
        "format": "cr:format",
        "includes": "cr:includes",
        "isLiveDataset": "cr:isLiveDataset",
        "jsonPath": "cr:jsonPath",
        "key": "cr:key",
        "md5": "cr:md5",
        "parentField": "cr:parentField",
        "path": "cr:path",
        "recordSet": "cr:recordSet",
        "references": "cr:references",
        "regex": "cr:regex",
        "repeated": "cr:repeated",
        "replace": "cr:replace",
        "samplingRate": "cr:samplingRate",
        "sc": "https://schema.org/",
        "separator": "cr:separator",
        "source": "cr:source",
        "subField": "cr:subField",
        "transform": "cr:transform"
    })
}

/// The description.
pub(super) fn croissant(whole: &WholeDataset<'_>) -> Value {
    let dataset = whole.file;
    let mut files = Vec::new();
    let mut archives = Vec::new();
    for (shard, mark) in &whole.marks {
        let id = format!("{}-{:06}", shard.split.name(), shard.index);
        archives.push(json!({"@id": id}));
        files.push(file(&id, &mark.file, "application/x-tar", &mark.sha256));
        for table in &mark.tables {
            let id = table.file.trim_start_matches("tables/").trim_end_matches(".parquet").replace(['/', '.'], "-");
            files.push(file(&id, &table.file, "application/x-parquet", &table.sha256));
        }
    }
    let suffix = dataset.image.member();
    let encoding = match dataset.image {
        ImageFormat::Png16 => "image/png",
        ImageFormat::Npy => "application/octet-stream",
        ImageFormat::FitsRice => "image/fits",
    };
    files.push(json!({
        "@type": "cr:FileSet", "@id": "images", "name": "images", "containedIn": archives, "encodingFormat": encoding, "includes": format!("*.{suffix}")
    }));
    let has_tables = whole.marks.iter().any(|(_, mark)| !mark.tables.is_empty());
    if has_tables {
        files.push(json!({
            "@type": "cr:FileSet", "@id": "frame-tables", "name": "frame-tables", "encodingFormat": "application/x-parquet",
            "includes": "tables/*/*.frames.parquet"
        }));
    }
    let licence =
        if dataset.licence.is_empty() { "unknown".to_owned() } else { format!("https://spdx.org/licenses/{}.html", dataset.licence) };
    json!({
        "@context": context(),
        "@type": "sc:Dataset",
        "conformsTo": CONFORMS_TO,
        "name": dataset.name,
        "description": format!(
            "{} labelled frames of a star camera, simulated by boresight {} from a recipe. Places count from the centre of the first pixel.",
            dataset.frames(),
            dataset.version
        ),
        "license": licence,
        "version": "1.0.0",
        "identifier": dataset.recipe_sha256,
        "distribution": files,
        "recordSet": record_sets(dataset.image, has_tables),
    })
}

fn file(id: &str, path: &str, encoding: &str, sha256: &str) -> Value {
    json!({"@type": "cr:FileObject", "@id": id, "name": id, "contentUrl": path, "encodingFormat": encoding, "sha256": sha256})
}

/// Labels of frames, and their images.
fn record_sets(image: ImageFormat, has_tables: bool) -> Value {
    let label = |name: &str, kind: &str, what: &str| {
        json!({
            "@type": "cr:Field", "@id": format!("frames/{name}"), "name": name, "description": what, "dataType": kind,
            "source": {"fileSet": {"@id": "frame-tables"}, "extract": {"column": name}}
        })
    };
    let frames = json!({
        "@type": "cr:RecordSet", "@id": "frames", "name": "frames", "description": "Labels of each frame",
        "field": [
            label("key", "sc:Integer", "Number of the frame"),
            label("split", "sc:Text", "Its split"),
            label("camera", "sc:Integer", "Number of its camera instance"),
            label("exposure_s", "sc:Float", "Length of the exposure in seconds"),
            label("focal_length_px", "sc:Float", "Focal length in pixels"),
        ]
    });
    let content = match image {
        ImageFormat::Png16 => "sc:ImageObject",
        ImageFormat::Npy | ImageFormat::FitsRice => "sc:Text",
    };
    let part = |name: &str, kind: &str, property: &str| {
        json!({
            "@type": "cr:Field", "@id": format!("images/{name}"), "name": name, "dataType": kind,
            "source": {"fileSet": {"@id": "images"}, "extract": {"fileProperty": property}}
        })
    };
    let images = json!({
        "@type": "cr:RecordSet", "@id": "image-files", "name": "image-files", "description": "Images by the name of their file, which begins with the number of the frame",
        "field": [part("filename", "sc:Text", "filename"), part("content", content, "content")]
    });
    if has_tables { json!([frames, images]) } else { json!([images]) }
}
