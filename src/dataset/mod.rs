//! Dataset: a recipe (a scene and what of it is drawn by chance) becomes labelled frames.

mod chance;
mod check;
mod distribution;
mod draws;
mod error;
mod frame_key;
mod frame_scene;
mod plan;
mod recipe;
mod scene_path;
mod sky_regions;

inner!(error::DatasetError);
inner!(frame_key::{DatasetSplit, FrameKey, ShardKey});
inner!(frame_scene::FrameScene);
inner!(plan::DatasetPlan);
inner!(recipe::{
    ApartBy, BallTable, ChoiceTable, DrawLevel, DrawSpread, DrawTable, FalseStarTable, HardTable, ImageFormat, NormalTable, QuantileTable,
    RECIPE_FORMAT, RecipeFile, SampleMember, SizeTable, SphereTable, SplitCounts, SplitTable,
});
