//! `[orbit]`: a camera on a satellite, whose velocity follows from the time of each exposure.

use hifitime::Epoch;

use super::pointing::{Plan, time};
use super::{OrbitTable, SceneError, SceneFile};
use crate::camera::{EARTH_RADIUS_KM, Orbit, OrbitState};
use crate::dual::{dot, normalize};
use crate::recording::Mount;
use crate::units::DAY_S;

/// Two-line elements older than this are not what they were, days.
const OLD_DAYS: f64 = 14.0;

impl OrbitTable {
    fn orbit(&self, path: &str) -> Result<Orbit, SceneError> {
        let wrong = |message: String| SceneError::Parse { path: path.to_owned(), message };
        match (&self.tle, &self.epoch_utc, self.position_km, self.velocity_km_s) {
            (Some([first, second]), None, None, None) => {
                Orbit::from_tle([first, second]).map_err(|error| wrong(format!("orbit.tle: {error}")))
            }
            (None, Some(epoch), Some(position_km), Some(velocity_km_s)) => {
                let epoch = time(path, "orbit.epoch_utc", epoch)?;
                let state = OrbitState { position_km, velocity_km_s };
                Orbit::from_state(epoch, state).map_err(|error| wrong(format!("orbit.position_km, orbit.velocity_km_s: {error}")))
            }
            _ => Err(wrong("orbit: give either tle, or all of epoch_utc, position_km and velocity_km_s".to_owned())),
        }
    }
}

/// The orbit of a scene, if it has one, and nothing that excludes it.
pub(super) fn of(path: &str, file: &SceneFile) -> Result<Option<Orbit>, SceneError> {
    let Some(table) = &file.orbit else { return Ok(None) };
    let refuse = |key: String, value: &str, remedy| Err(SceneError::Value { path: path.to_owned(), key, value: value.to_owned(), remedy });
    if file.site.is_some() {
        return refuse("orbit".to_owned(), "given", "stands beside a [site] on the ground: keep one of the two");
    }
    if file.mount.is_some_and(|mount| mount.kind == Mount::Fixed) {
        return refuse("orbit".to_owned(), "given", "stands beside a mount that is fixed to the ground: keep one of the two");
    }
    if let Some(index) = file.frames.iter().position(|frame| frame.velocity_km_s.is_some()) {
        return refuse(format!("frames[{index}].velocity_km_s"), "given", "stands beside an [orbit], which gives it: keep one of the two");
    }
    table.orbit(path).map(Some)
}

/// Where the camera is in exposure `number`.
fn state(path: &str, orbit: &Orbit, number: usize, time: Option<Epoch>) -> Result<(Epoch, OrbitState), SceneError> {
    let Some(now) = time else {
        let remedy = "needs the time of every exposure: give series.start_utc, or time_utc of each frame";
        return Err(SceneError::Value { path: path.to_owned(), key: "orbit".to_owned(), value: "given".to_owned(), remedy });
    };
    let error = |error| SceneError::Parse { path: path.to_owned(), message: format!("orbit, exposure {number}: {error}") };
    Ok((now, orbit.at(now).map_err(error)?))
}

/// The barycentric velocity of the camera, of which `of_earth` is the Earth's.
pub(super) fn velocity_km_s(
    path: &str,
    orbit: &Orbit,
    number: usize,
    time: Option<Epoch>,
    of_earth: [f64; 3],
) -> Result<[f64; 3], SceneError> {
    let (_, state) = state(path, orbit, number, time)?;
    Ok([0, 1, 2].map(|axis| of_earth[axis] + state.velocity_km_s[axis]))
}

/// What is to be said of the exposures of a camera in orbit.
#[derive(Debug, Default)]
pub(super) struct Seen {
    /// How many look at the Earth, and the first of them.
    hidden: usize,
    first: usize,
    oldest_days: f64,
}

impl Seen {
    /// Looks at an exposure.
    pub(super) fn look(&mut self, path: &str, orbit: &Orbit, number: usize, plan: &Plan) -> Result<(), SceneError> {
        let (now, state) = state(path, orbit, number, plan.time)?;
        self.oldest_days = self.oldest_days.max(days_apart(now, orbit.epoch()));
        if sees_earth(&state, plan.attitude.rows()[2]) {
            if self.hidden == 0 {
                self.first = number;
            }
            self.hidden += 1;
        }
        Ok(())
    }

    /// Says it.
    pub(super) fn tell(&self, path: &str, file: &SceneFile, all: usize) {
        let Self { hidden, first, oldest_days: oldest } = self;
        if file.orbit.as_ref().is_some_and(|table| table.tle.is_some()) && *oldest > OLD_DAYS {
            tracing::warn!("{path}: orbit.tle is {oldest:.0} days from an exposure; elements are good for days, take those nearest to it");
        }
        if *hidden > 0 {
            tracing::warn!(
                "{path}: {hidden} of {all} exposures look at the Earth (the first is {first}); stars are rendered as if it were not there"
            );
        }
    }
}

/// Whether the Earth's disc lies in this direction.
fn sees_earth(state: &OrbitState, direction: [f64; 3]) -> bool {
    let distance_km = dot(state.position_km, state.position_km).sqrt();
    let toward_earth = -dot(normalize(state.position_km), direction);
    toward_earth > (1.0 - (EARTH_RADIUS_KM / distance_km).min(1.0).powi(2)).sqrt()
}

fn days_apart(a: Epoch, b: Epoch) -> f64 {
    (a - b).to_seconds().abs() / DAY_S
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 42164 km from the Earth's centre its disc has a radius of asin(6378.137/42164) = 8.70°.
    #[test]
    fn the_earth_hides_its_disc_and_no_more() {
        let state = OrbitState { position_km: [42_164.0, 0.0, 0.0], velocity_km_s: [0.0, 3.07, 0.0] };
        let view = |from_earth_deg: f64| {
            let (sine, cosine) = from_earth_deg.to_radians().sin_cos();
            sees_earth(&state, [-cosine, 0.0, sine])
        };
        assert!(view(0.0) && view(8.69) && !view(8.71) && !view(180.0));
    }
}
