//! Circumstances of the frames: time and place, motion, telemetry, in the units of the physics.

use super::{FirstRow, FrameEntry, Recording, Shutter, Site};
use crate::camera::{GroundSite, ObserverError, observation};
use crate::effects::{Observation, Sensor};
use crate::units::DEG_RAD;

/// What drifts, minus its mean over the frames that have it.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Offsets {
    pub(crate) time_h: Option<f64>,
    /// Number of the frame.
    pub(crate) order: Option<f64>,
    pub(crate) temperature_k: Option<f64>,
    pub(crate) pressure_hpa: Option<f64>,
}

impl From<&Site> for GroundSite {
    fn from(site: &Site) -> Self {
        Self {
            pressure_hpa: site.pressure_hpa,
            temperature_c: site.temperature_c,
            relative_humidity: site.relative_humidity,
            ..Self::from_degrees(site.latitude_deg, site.longitude_deg, site.height_m)
        }
    }
}

impl Recording {
    /// The circumstances of every frame, in order. Telemetry that drifts (time, temperature, pressure) counts from its mean over
    /// the frames that have it.
    pub fn observations(&self) -> Result<Vec<Observation>, (usize, ObserverError)> {
        const SECONDS_PER_HOUR: f64 = 3600.0;
        let first = self.frames.iter().find_map(|frame| frame.time_utc);
        let hours = self.offsets(|frame| {
            let entry = &self.frames[frame];
            Some((entry.time_utc? - first?).to_seconds() / SECONDS_PER_HOUR)
        });
        let orders = self.offsets(|frame| Some(self.frames[frame].number as f64));
        let kelvins = self.offsets(|frame| self.frames[frame].temperature_c);
        let hectopascals = self.offsets(|frame| self.frames[frame].covariates.get("pressure_hpa").copied());
        (0..self.frames.len())
            .map(|frame| {
                let offsets = Offsets {
                    time_h: hours[frame],
                    order: orders[frame],
                    temperature_k: kelvins[frame],
                    pressure_hpa: hectopascals[frame],
                };
                self.observation_of(&self.frames[frame], offsets).map_err(|error| (frame, error))
            })
            .collect()
    }

    /// The circumstances of a frame, of which its place among all is told.
    pub(crate) fn observation_of(&self, entry: &FrameEntry, offsets: Offsets) -> Result<Observation, ObserverError> {
        let site = self.site.as_ref().map(GroundSite::from);
        let sensor = Sensor {
            width_px: self.camera.width_px,
            height_px: self.camera.height_px,
            line_time_s: self.line_time_s(),
            last_row_first: self.camera.first_row == Some(FirstRow::Bottom),
        };
        Ok(Observation {
            time_offset_h: offsets.time_h,
            order_offset: offsets.order,
            temperature_offset_k: offsets.temperature_k,
            pressure_offset_hpa: offsets.pressure_hpa,
            rate_rad_s: entry.rate_deg_s.map(|rate| rate.map(|component| component * DEG_RAD)),
            exposure_s: entry.exposure_s,
            sensor: Some(sensor),
            ..observation(entry.time_utc, site.as_ref(), entry.velocity_km_s)?
        })
    }

    /// How much later each row of a higher number is exposed.
    fn line_time_s(&self) -> Option<f64> {
        match (self.camera.shutter?, self.camera.line_time_us) {
            (Shutter::Global, _) => Some(0.0),
            (Shutter::Rolling, time_us) => {
                let sign = if self.camera.first_row == Some(FirstRow::Bottom) { -1.0 } else { 1.0 };
                time_us.map(|time_us| sign * time_us * 1e-6)
            }
        }
    }

    /// A number of each frame minus the mean over the frames that have it.
    fn offsets(&self, number: impl Fn(usize) -> Option<f64>) -> Vec<Option<f64>> {
        let values: Vec<Option<f64>> = (0..self.frames.len()).map(number).collect();
        let known: Vec<f64> = values.iter().copied().flatten().collect();
        let mean = known.iter().sum::<f64>() / known.len().max(1) as f64;
        values.into_iter().map(|value| value.map(|value| value - mean)).collect()
    }
}
