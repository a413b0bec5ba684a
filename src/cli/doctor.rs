//! `boresight doctor`: adapter, driver, versions, and a check of the GPU against the CPU.

use anyhow::Result;
use boresight::catalog::Catalog;
use boresight::gpu::{AdapterReport, adapters};
use boresight::imaging::twin_check;
use boresight::provenance::Provenance;
use boresight::report;
use clap::Args;
use serde::Serialize;

use super::options::heading;
use super::{Answer, output};

/// Arguments of `doctor`.
#[derive(Debug, Args)]
#[command(next_help_heading = heading::OUTPUT)]
pub(crate) struct DoctorArgs {
    /// Print the result as one JSON object on stdout, and nothing else
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct DoctorObject {
    format: &'static str,
    adapters: Vec<Adapter>,
    twin_check: Twins,
    catalog: String,
    threads: usize,
    provenance: Provenance,
}

#[derive(Serialize)]
struct Adapter {
    name: String,
    driver: String,
    interface: String,
    is_software: bool,
}

/// How GPU and CPU agree.
#[derive(Serialize)]
#[serde(tag = "status", rename_all = "kebab-case")]
enum Twins {
    Agree(Differences),
    Differ(Differences),
    NotRun { reason: String },
}

#[derive(Serialize)]
struct Differences {
    adapter: String,
    pixels: usize,
    electrons_in_tolerances: f64,
    differing_pixels: usize,
    largest_difference_dn: u16,
}

/// Looks, checks and prints.
pub(crate) fn doctor(args: &DoctorArgs) -> Result<Answer> {
    let adapters: Vec<Adapter> = adapters()
        .into_iter()
        .map(|AdapterReport { name, driver, interface, is_software, .. }| Adapter { name, driver, interface, is_software })
        .collect();
    let twins = match twin_check() {
        Err(error) => Twins::NotRun { reason: error.to_string() },
        Ok(found) => {
            let agree = found.agrees();
            let differences = Differences {
                adapter: found.adapter,
                pixels: found.pixels,
                electrons_in_tolerances: found.electrons_in_tolerances,
                differing_pixels: found.differing_pixels,
                largest_difference_dn: found.largest_difference_dn,
            };
            if agree { Twins::Agree(differences) } else { Twins::Differ(differences) }
        }
    };
    let catalog = Catalog::embedded();
    let object = DoctorObject {
        format: "boresight-doctor/1",
        adapters,
        twin_check: twins,
        catalog: format!("{} stars, {}", catalog.stars.len(), catalog.source),
        threads: rayon::current_num_threads(),
        provenance: output::provenance(),
    };
    if args.json {
        output::print(&output::json_text(&object)?)?;
    } else {
        output::print_page(&text(&object))?;
    }
    // No adapter is no fault: the program works on the CPU. Twins that differ are one.
    Ok(if matches!(object.twin_check, Twins::Differ(_)) { Answer::No } else { Answer::Yes })
}

fn text(object: &DoctorObject) -> String {
    let version = boresight::provenance::version();
    let mut text = format!("boresight {version}, {} threads\ncatalogue: {}\n\n", object.threads, object.catalog);
    if object.adapters.is_empty() {
        text += "no Vulkan adapter: frames are rendered on the CPU\n";
    } else {
        let rows: Vec<[&str; 4]> = object
            .adapters
            .iter()
            .map(|adapter| {
                let kind = if adapter.is_software { "software" } else { "hardware" };
                [adapter.name.as_str(), adapter.driver.as_str(), adapter.interface.as_str(), kind]
            })
            .collect();
        text += &report::table(&["adapter", "driver", "interface", "kind"], &rows);
    }
    text.push('\n');
    let lines = |verdict: &str, found: &Differences| {
        format!(
            "twin check: {verdict} — {} against the CPU: expected electrons within {:.2} of the tolerance (1e-5); of {} noisy pixels {} differ, by {} DN at most\n",
            found.adapter, found.electrons_in_tolerances, found.pixels, found.differing_pixels, found.largest_difference_dn
        )
    };
    text + &match &object.twin_check {
        Twins::Agree(found) => lines("good", found),
        Twins::Differ(found) => lines("BAD, do not trust --backend gpu here", found),
        Twins::NotRun { reason } => format!("twin check: not run, {reason}\n"),
    }
}
