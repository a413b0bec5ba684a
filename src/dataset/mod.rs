//! Dataset: a recipe (a scene and what of it is drawn by chance) becomes labelled frames.

mod chance;
mod distribution;
mod error;
mod recipe;
mod scene_path;

inner!(error::DatasetError);
inner!(recipe::{
    ApartBy, BallTable, ChoiceTable, DrawLevel, DrawSpread, DrawTable, FalseStarTable, HardTable, ImageFormat, NormalTable, QuantileTable,
    RECIPE_FORMAT, RecipeFile, SampleMember, SizeTable, SphereTable, SplitCounts, SplitTable,
});
