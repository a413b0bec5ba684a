//! Options for the circumstances of bare images: times, exposure, site.

use std::str::FromStr;

use anyhow::Result;
use boresight::recording::{GivenCircumstances, OpenOptions, Plane, Recording, Site};
use clap::Args;

use super::identify::positive;
use super::options::heading;

/// What is said of the frames; it goes before what files say.
#[derive(Debug, Default, Args)]
#[command(next_help_heading = heading::INPUT)]
pub(crate) struct ToldArgs {
    /// Middle of the exposure, UTC: one for all frames, one for each (given again, or with commas between), or the first with --interval-s
    #[arg(long, value_name = "TIME", value_delimiter = ',')]
    time: Vec<Time>,
    /// Time from the middle of a frame to that of the next, where --time gives the first
    #[arg(long, value_name = "SECONDS", value_parser = positive, requires = "time", allow_negative_numbers = true)]
    interval_s: Option<f64>,
    /// Length of every exposure
    #[arg(long, alias = "exposure", value_name = "SECONDS", value_parser = positive, allow_negative_numbers = true)]
    exposure_s: Option<f64>,
    /// Where the camera stands on the ground: latitude and longitude in degrees (east positive), and the height above sea in m
    #[arg(long, value_name = "LAT,LON[,HEIGHT]", value_parser = site, allow_hyphen_values = true)]
    site: Option<Site>,
    /// Which image of a file that holds several: the plane of a FITS cube or the page of a TIFF file, from 1; or
    /// `colours`: the three planes of a cube are colours, and their luminance is used
    #[arg(long, value_name = "N|colours", value_parser = plane)]
    plane: Option<Plane>,
}

/// A time, or a date alone.
#[derive(Clone, Copy, Debug)]
struct Time {
    told: hifitime::Epoch,
    is_date: bool,
}

impl FromStr for Time {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        GivenCircumstances::parse_time(text).map(|(told, is_date)| Self { told, is_date })
    }
}

/// Reads a place on the ground.
fn site(text: &str) -> std::result::Result<Site, String> {
    let fault = "write latitude and longitude in degrees, east positive, and the height in m if it is known: 52.22,4.42 or 52.22,4.42,10";
    let numbers: Option<Vec<f64>> =
        text.split(',').map(|part| part.trim().parse().ok().filter(|number: &f64| number.is_finite())).collect();
    let (latitude_deg, longitude_deg, height_m) = match numbers.as_deref() {
        Some(&[latitude, longitude]) => (latitude, longitude, 0.0),
        Some(&[latitude, longitude, height]) => (latitude, longitude, height),
        _ => return Err(fault.into()),
    };
    let is_place = latitude_deg.abs() <= 90.0 && (-180.0..=360.0).contains(&longitude_deg) && (-1000.0..=100_000.0).contains(&height_m);
    if !is_place {
        return Err(format!("latitude from -90 to 90, longitude from -180 to 360, height from -1000 to 100000 m; {fault}"));
    }
    Ok(Site { latitude_deg, longitude_deg, height_m, pressure_hpa: None, temperature_c: None, relative_humidity: None })
}

/// Reads which image is meant.
fn plane(text: &str) -> std::result::Result<Plane, String> {
    if text == "colours" || text == "colors" {
        return Ok(Plane::Colours);
    }
    let number = text.parse::<usize>().ok().and_then(|number| number.checked_sub(1));
    number.map(Plane::Index).ok_or_else(|| "give a number from 1, or `colours`".into())
}

impl ToldArgs {
    /// How files are opened.
    pub(crate) fn open_options(&self, keep_going: bool) -> OpenOptions {
        OpenOptions { keep_going, plane: self.plane }
    }

    /// Tells the recording.
    pub(crate) fn tell(&self, recording: &mut Recording) -> Result<()> {
        let told = GivenCircumstances {
            times_utc: self.time.iter().map(|time| time.told).collect(),
            dates_only: self.time.iter().any(|time| time.is_date),
            interval_s: self.interval_s,
            exposure_s: self.exposure_s,
            site: self.site,
        };
        Ok(recording.tell(&told)?)
    }
}
