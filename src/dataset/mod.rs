//! Dataset: a recipe (a scene and what of it is drawn by chance) becomes labelled frames in archives.
//!
//! ```text
//!   recipe.toml ──► DatasetPlan ──► FrameScene ──► Rendered ──► DatasetSample ──► shards, marks, SHA256SUMS
//!   scene             checked         tables        render        files              folder
//!                                                                                      │
//!                                       finish: card, Croissant, statistics ◄──────────┘
//! ```
//! A frame follows from recipe and number alone: draws are addressed (`chance`), so any frame can be made again by itself, on any machine, in any order.

mod background_files;
mod card;
mod chance;
mod check;
mod contact_sheet;
mod croissant;
mod distribution;
mod drawn_shares;
mod draws;
mod error;
mod export;
mod export_forms;
mod finish;
mod folder;
mod frame_key;
mod frame_scene;
mod image_files;
mod label_tables;
mod leaks;
mod pixel_labels;
mod plan;
mod recipe;
mod run;
mod sample;
mod sample_labels;
mod samples;
mod scene_path;
mod shard;
mod shard_statistics;
mod sky_regions;
mod source_files;
mod statistics_page;
mod table_columns;
mod tar;
mod telemetry;
mod verify;
mod whole_dataset;

inner!(chance::AddressedChance);
inner!(contact_sheet::{base64, escaped});
inner!(error::DatasetError);
inner!(drawn_shares::DrawnShares);
inner!(export::{ExportCounts, ExportForm, export_dataset});
inner!(finish::finish);
inner!(folder::{DATASET_FORMAT, DatasetFile, DescribedName, DescribedSplit});
inner!(frame_key::{DatasetSplit, FrameKey, ShardKey});
inner!(frame_scene::FrameScene);
inner!(leaks::SharedBySplits);
inner!(pixel_labels::PIXEL_CLASSES);
inner!(plan::DatasetPlan);
inner!(recipe::{
    ApartBy, BackgroundTable, BallTable, ChoiceTable, DrawLevel, DrawSpread, DrawTable, FalseStarTable, HardTable, ImageFormat, NormalTable, QuantileTable,
    RECIPE_FORMAT, RecipeFile, SampleMember, SizeTable, SphereTable, SplitCounts, SplitTable,
});
inner!(run::{DatasetProgress, DatasetRun, ShardShare});
inner!(sample::DatasetSample);
inner!(sample_labels::{LightColumns, SAMPLE_FORMAT, SampleLabels});
inner!(scene_path::{PlaceKind, ScenePath});
inner!(shard::{HashedFile, SHARD_FORMAT, ShardMark});
inner!(shard_statistics::ShardStatistics);
inner!(table_columns::{TableCells, TableColumn, TableFile, TableWriter});
inner!(verify::{VerifyOptions, verify});
inner!(verify::result::{VERIFY_FORMAT, VerifyCheck, VerifyFault, VerifyResult});
