//! Examples at the end of each verb's help. Every line that begins with `boresight` is run by a test, in a folder with a scene, a recording of it and
//! calibrations.

pub(crate) const SIMULATE: &str = "\
Examples:
  boresight preset show machine-vision-35mm > my-scene.toml
  boresight simulate scene.toml -o simulated
  boresight simulate scene.toml -o simulated --force --clean --masks
  boresight simulate scene.toml -o other --seed 2 --backend cpu";

pub(crate) const DETECT: &str = "\
Examples:
  boresight detect night/frames/0000.fits
  boresight detect night -o detected --centroid windowed
  boresight detect night --json > stars.json";

pub(crate) const IDENTIFY: &str = "\
Examples:
  boresight identify night/frames/*.fits
  boresight identify night -o identified --fits
  boresight identify night/frames/0000.fits --focal-length-px 1800 --json";

pub(crate) const CALIBRATE: &str = "\
Examples:
  boresight calibrate night -o calibrated
  boresight calibrate night --solve auto --physics known
  boresight calibrate night --update cal/calibrate.json -o updated";

pub(crate) const DIAGNOSE: &str = "\
Examples:
  boresight diagnose night
  boresight diagnose night -o diagnosis --physics known --write-camera found.toml";

pub(crate) const MAP: &str = "\
Examples:
  boresight map cal/calibrate.json --grid 3
  boresight map cal/calibrate.json --grid 21 --json > map.json";

pub(crate) const COMPARE: &str = "\
Examples:
  boresight compare old/calibrate.json cal/calibrate.json
  boresight compare old/calibrate.json cal/calibrate.json --max-px 5 -o difference";

pub(crate) const EXPORT: &str = "\
Examples:
  boresight export cal/calibrate.json --to opencv -o opencv.yml
  boresight export cal/calibrate.json --to sip -o headers/";

pub(crate) const IMPORT: &str = "\
Examples:
  boresight import camera.yml
  boresight import camera.yml --from opencv -o imported";

pub(crate) const RUN: &str = "\
Examples:
  boresight run scene.toml
  boresight run scene.toml -o tried --misidentify 0.2 --seed 3";

pub(crate) const DEMO: &str = "\
Examples:
  boresight demo
  boresight demo --force --misidentify 0 --backend cpu";

pub(crate) const TEST: &str = "\
Examples:
  boresight test --init machine-vision-35mm > my-suite.toml
  boresight test suite.toml -o tested --junit tested.xml
  boresight test suite.toml --seed 2 --undecided pass
  boresight test --metrics";

pub(crate) const CATALOG: &str = "\
Examples:
  boresight catalog import table.csv -o deep.bin
  boresight catalog import table.csv -o bright.bin --faintest 5.5 --json";

pub(crate) const BLIND: &str = "\
Examples:
  boresight blind generate --family null --to 2 -o blind
  boresight blind run --family null --to 1 -o blind --nulls 100";

pub(crate) const EFFECTS: &str = "\
Examples:
  boresight effects
  boresight effects refraction
  boresight effects --signature even-odd";

pub(crate) const DATASET: &str = "\
Examples:
  boresight dataset recipe.toml --plan
  boresight dataset recipe.toml -o stars
  boresight dataset recipe.toml -o stars --shard 0/16
  boresight dataset recipe.toml --scene 17 > frame.toml";

pub(crate) const DATASET_FINISH: &str = "\
Examples:
  boresight dataset finish stars
  boresight dataset finish stars --json > dataset.json";

pub(crate) const DATASET_VERIFY: &str = "\
Examples:
  boresight dataset verify stars
  boresight dataset verify stars --frames 10 --seed 7 --json > verdict.json";

pub(crate) const DATASET_EXPORT: &str = "\
Examples:
  boresight dataset export stars --to coco -o coco
  boresight dataset export stars --to parquet -o parquet";

pub(crate) const PRESET: &str = "\
Examples:
  boresight preset list
  boresight preset show cubesat-tracker > tracker.toml";

pub(crate) const SCHEMA: &str = "\
Examples:
  boresight schema
  boresight schema calibrate
  boresight schema scene > scene.schema.json";

pub(crate) const DOCTOR: &str = "\
Examples:
  boresight doctor
  boresight doctor --json > machine.json";

pub(crate) const COMPLETIONS: &str = "\
Examples:
  boresight completions bash > boresight.bash
  boresight completions zsh > _boresight";

pub(crate) const MAN: &str = "\
Examples:
  boresight man > boresight.1
  boresight man -o man1";
