//! `boresight doctor`: adapter, driver, versions, and a check of the GPU against the CPU.

use anyhow::Result;
use boresight::catalog::Catalog;
use boresight::gpu::adapters;
use boresight::imaging::{DOCTOR_FORMAT, DoctorResult, ListedAdapter, TwinCheck, TwinDifferences, twin_check};
use boresight::report;
use clap::Args;

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

/// Looks, checks and prints.
pub(crate) fn doctor(args: &DoctorArgs) -> Result<Answer> {
    let adapters = adapters().into_iter().map(ListedAdapter::from).collect();
    let twins = match twin_check() {
        Err(error) => TwinCheck::NotRun { reason: error.to_string() },
        Ok(found) => {
            let agree = found.agrees();
            let differences = TwinDifferences::from(found);
            if agree { TwinCheck::Agree(differences) } else { TwinCheck::Differ(differences) }
        }
    };
    let catalog = Catalog::embedded();
    let object = DoctorResult {
        format: DOCTOR_FORMAT,
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
    Ok(if matches!(object.twin_check, TwinCheck::Differ(_)) { Answer::No } else { Answer::Yes })
}

fn text(object: &DoctorResult) -> String {
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
    let lines = |verdict: &str, found: &TwinDifferences| {
        format!(
            "twin check: {verdict} — {} against the CPU: expected electrons within {:.2} of the tolerance (1e-5); of {} noisy pixels {} differ, by {} DN at most\n",
            found.adapter, found.electrons_in_tolerances, found.pixels, found.differing_pixels, found.largest_difference_dn
        )
    };
    text + &match &object.twin_check {
        TwinCheck::Agree(found) => lines("good", found),
        TwinCheck::Differ(found) => lines("BAD, do not trust --backend gpu here", found),
        TwinCheck::NotRun { reason } => format!("twin check: not run, {reason}\n"),
    }
}
