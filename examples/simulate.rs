//! Renders the frames of a scene and says which stars are on them: `cargo run --release --example simulate -- SCENE.toml`
#![allow(clippy::print_stdout, reason = "a command")]

use std::path::Path;

use boresight::catalog::Catalog;
use boresight::render::{Backend, Renderer};
use boresight::scene::Scene;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let path = std::env::args().nth(1).ok_or("give a scene: boresight preset show cubesat-tracker > scene.toml")?;
    let scene = Scene::open(Path::new(&path))?;
    let renderer = Renderer::new(&scene, Catalog::embedded(), Backend::Cpu)?;
    for index in 0..scene.exposures.len() {
        let rendered = renderer.render(index)?;
        let brightest = rendered.pixels_dn.iter().max().copied().unwrap_or(0);
        println!("frame {index}: {} stars reach it, the highest count is {brightest} DN", rendered.stars.len());
    }
    Ok(())
}
