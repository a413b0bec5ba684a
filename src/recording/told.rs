//! Declared circumstances of bare images: times, exposure and site from the command line.

use hifitime::{Duration, Epoch};
use thiserror::Error;

use super::{FrameEntry, Recording, Site, time};

/// What is said, beside the files.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct GivenCircumstances {
    /// Middle of the exposure: of all frames, of the first (with [`Self::interval_s`]), or of every one. Empty where nothing is said.
    pub times_utc: Vec<Epoch>,
    /// Whether a time is a date without a clock.
    pub dates_only: bool,
    /// From frame to frame, where the first one's time alone is given.
    pub interval_s: Option<f64>,
    /// Length of every exposure.
    pub exposure_s: Option<f64>,
    /// Where the camera stands.
    pub site: Option<Site>,
}

/// Why what is said cannot be.
#[derive(Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum ToldError {
    /// Neither one time nor one a frame.
    #[error("{times} times are given for {frames} frames; give one for all, one for each in their order, or the first and the interval")]
    Count {
        /// Times given.
        times: usize,
        /// Frames.
        frames: usize,
    },
    /// An interval without the one time that it counts from.
    #[error("an interval counts from the first frame's time: give that time, and no other")]
    Interval,
    /// Time runs backwards.
    #[error("the time {time} of {frame} is earlier than {previous} of the frame before; give the times in the order of the frames")]
    Backwards {
        /// The frame.
        frame: String,
        /// Its time, UTC.
        time: String,
        /// The time before, UTC.
        previous: String,
    },
    /// A site is of no use without a clock.
    #[error("with a site the time of day decides where the zenith is: give the time with its clock, such as 2026-03-01T22:15:07Z")]
    NoClock,
}

impl GivenCircumstances {
    /// Reads a time in ISO 8601 (UTC without a zone), or a date alone, which is taken at midnight: the second value says so.
    pub fn parse_time(text: &str) -> Result<(Epoch, bool), String> {
        let text = text.trim();
        if text.len() == 10
            && let Ok(midnight) = time::parse_utc(&format!("{text}T00:00:00"))
        {
            return Ok((midnight, true));
        }
        time::parse_utc(text).map(|time| (time, false))
    }
}

impl Recording {
    /// Takes over what is said; it goes before what files say, and [`Recording::notes`] tell of that.
    pub fn tell(&mut self, told: &GivenCircumstances) -> Result<(), ToldError> {
        if told.site.is_some() && told.dates_only {
            return Err(ToldError::NoClock);
        }
        if told.interval_s.is_some() && told.times_utc.len() != 1 {
            return Err(ToldError::Interval);
        }
        self.tell_times(told)?;
        if let Some(exposure_s) = told.exposure_s {
            self.say_replaced("exposure", |entry| entry.exposure_s.is_some_and(|known| known != exposure_s));
            self.frames.iter_mut().for_each(|entry| entry.exposure_s = Some(exposure_s));
        }
        if told.site.is_some() {
            self.site = told.site;
        }
        if self.site.is_some() {
            self.drop_unzoned();
        }
        Ok(())
    }

    fn tell_times(&mut self, told: &GivenCircumstances) -> Result<(), ToldError> {
        let (times, all) = (&told.times_utc, self.frames.len() + self.skipped.len());
        if times.len() > 1 && times.len() != all {
            return Err(ToldError::Count { times: times.len(), frames: all });
        }
        let Some(&first) = times.first() else { return Ok(()) };
        let of = |entry: &FrameEntry| match told.interval_s {
            Some(interval_s) => first + Duration::from_seconds(interval_s * entry.number as f64),
            None => times.get(entry.number).copied().unwrap_or(first),
        };
        for pair in self.frames.windows(2) {
            let [previous, next] = [&pair[0], &pair[1]].map(of);
            if next < previous {
                let (time, previous) = (time::format_utc(next), time::format_utc(previous));
                return Err(ToldError::Backwards { frame: pair[1].name(), time, previous });
            }
        }
        self.say_replaced("time", |entry| entry.time_utc.is_some_and(|known| known != of(entry)));
        for entry in &mut self.frames {
            entry.time_utc = Some(of(entry));
            entry.zone_unknown = false;
        }
        if told.dates_only {
            self.notes.push("the time of day is not told: the frames are taken at midnight, UTC".to_owned());
        } else if times.len() == 1 && told.interval_s.is_none() && all > 1 {
            self.notes.push(format!(
                "one time is told for {all} frames, which are then of one moment; tell one for each, or the interval, if they are not"
            ));
        }
        Ok(())
    }

    fn say_replaced(&mut self, what: &str, differs: impl Fn(&FrameEntry) -> bool) {
        let mut others = self.frames.iter().filter(|entry| differs(entry));
        if let Some(first) = others.next() {
            let (name, count) = (first.name(), 1 + others.count());
            self.notes
                .push(format!("{count} frames say another {what} themselves, {name} the first of them; the one that was told is used"));
        }
    }

    /// A time that may be off by hours puts the zenith anywhere.
    fn drop_unzoned(&mut self) {
        let mut dropped = 0;
        for entry in self.frames.iter_mut().filter(|entry| entry.zone_unknown) {
            (entry.time_utc, entry.zone_unknown) = (None, false);
            dropped += 1;
        }
        if dropped > 0 {
            self.notes.push(format!(
                "the times of {dropped} frames are not used: their zone is unknown, and with a site the time of day counts; tell the times (--time)"
            ));
        }
    }
}
