//! Identifies the stars of images, lost in space: `cargo run --release --example identify -- IMAGE…`
#![allow(clippy::print_stdout, reason = "a command")]

use boresight::catalog::Catalog;
use boresight::detect::{DetectOptions, detect};
use boresight::identify::{Identification, IdentifyOptions, Index, identify};
use boresight::recording::Recording;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let recording = Recording::open(&std::env::args().skip(1).collect::<Vec<_>>())?;
    let catalog = Catalog::embedded();
    let index = Index::new(catalog);
    for frame in 0..recording.frames.len() {
        let detections = detect(&recording.load_frame(frame)?, &DetectOptions::default())?;
        let name = recording.frame_name(frame);
        match identify(&detections, catalog, &index, &[], &IdentifyOptions::default()) {
            Identification::Identified(solution) => {
                let (right_ascension_rad, declination_rad) = solution.centre().radec_rad();
                let degrees = [right_ascension_rad.to_degrees(), declination_rad.to_degrees()];
                println!("{name}: centre {degrees:.4?}°, {} stars, {:.3} px rms", solution.matches.len(), solution.rms_px);
            }
            Identification::NotIdentified { reason, .. } => println!("{name}: {reason}"),
        }
    }
    Ok(())
}
