//! Times in files: ISO 8601, UTC.

use hifitime::{Duration, Epoch, TimeScale};

/// Reads `2026-03-01T22:15:07.250Z`. Without zone it is UTC, `+02:00` is taken off; a blank may stand for the T.
pub(super) fn parse_utc(text: &str) -> Result<Epoch, String> {
    parse_in(text, TimeScale::UTC)
}

/// Reads the same in another time scale, as FITS files with a TIMESYS give it.
pub(super) fn parse_in(text: &str, scale: TimeScale) -> Result<Epoch, String> {
    let fault = || format!("{text:?} is no time; write it as \"2026-03-01T22:15:07.250Z\" (UTC, ISO 8601)");
    let trimmed = text.trim();
    if !trimmed.is_ascii() {
        return Err(fault());
    }
    let (date, clock) = trimmed.split_once(['T', 't', ' ']).ok_or_else(fault)?;
    let (clock, offset_s) = split_zone(clock).ok_or_else(fault)?;
    if offset_s != 0 && scale != TimeScale::UTC {
        return Err(fault());
    }
    let [year, month, day] = fields(date, '-').ok_or_else(fault)?;
    let [hour, minute, second] = fields(clock, ':').ok_or_else(fault)?;
    let (second, fraction) = second.split_once('.').unwrap_or((second, ""));
    let nanoseconds = nanoseconds(fraction).ok_or_else(fault)?;
    let year: i32 =
        digits(year, 4).and_then(|year| i32::try_from(year).ok()).filter(|year| (1900..=2200).contains(year)).ok_or_else(fault)?;
    let [month, day, hour, minute, second] = [month, day, hour, minute, second].map(|field| digits(field, 2).map(|number| number as u8));
    let (Some(month), Some(day), Some(hour), Some(minute), Some(second)) = (month, day, hour, minute, second) else {
        return Err(fault());
    };
    if hour > 23 || minute > 59 || second > 60 {
        return Err(fault());
    }
    let epoch = Epoch::maybe_from_gregorian(year, month, day, hour, minute, second, nanoseconds, scale).map_err(|_| fault())?;
    // hifitime takes second 60 for a second second 59; TAI can tell them apart
    let epoch = if second == 60 { epoch.to_time_scale(TimeScale::TAI) + Duration::from_seconds(1.0) } else { epoch };
    Ok(epoch - Duration::from_seconds(offset_s as f64))
}

/// Writes a time as [`parse_utc`] reads it, to the nanosecond, without trailing zeros.
pub(super) fn format_utc(epoch: Epoch) -> String {
    let (year, month, day, hour, minute, second, nanoseconds) = epoch.to_gregorian_utc();
    let fraction = format!(".{nanoseconds:09}");
    let fraction = fraction.trim_end_matches('0').trim_end_matches('.');
    format!("{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{second:02}{fraction}")
}

/// The clock without its zone, and the zone in seconds east.
fn split_zone(clock: &str) -> Option<(&str, i64)> {
    if let Some(clock) = clock.strip_suffix(['Z', 'z']) {
        return Some((clock, 0));
    }
    let Some(at) = clock.find(['+', '-']) else {
        return Some((clock, 0));
    };
    let (clock, zone) = clock.split_at(at);
    let sign = if zone.starts_with('-') { -1 } else { 1 };
    let (hours, minutes) = zone[1..].split_once(':')?;
    let (hours, minutes) = (digits(hours, 2)?, digits(minutes, 2)?);
    (hours <= 14 && minutes <= 59).then(|| (clock, sign * (i64::from(hours) * 3600 + i64::from(minutes) * 60)))
}

fn fields(text: &str, separator: char) -> Option<[&str; 3]> {
    let mut parts = text.split(separator);
    let found = [parts.next()?, parts.next()?, parts.next()?];
    parts.next().is_none().then_some(found)
}

/// Exactly `count` digits.
fn digits(text: &str, count: usize) -> Option<u32> {
    (text.len() == count && text.bytes().all(|byte| byte.is_ascii_digit())).then(|| text.parse().ok()).flatten()
}

/// The digits behind the point; what lies beyond the nanosecond is cut off.
fn nanoseconds(fraction: &str) -> Option<u32> {
    if !fraction.bytes().all(|byte| byte.is_ascii_digit()) {
        return None;
    }
    let mut padded: String = fraction.chars().take(9).collect();
    while padded.len() < 9 {
        padded.push('0');
    }
    padded.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reads_what_recordings_hold_and_writes_it_back() {
        for (text, written) in [
            ("2019-07-29T20:47:26Z", "2019-07-29T20:47:26"),
            ("2026-03-01T22:15:07.250Z", "2026-03-01T22:15:07.25"),
            ("2026-03-01 22:15:07.000000001", "2026-03-01T22:15:07.000000001"),
            ("2026-03-01T00:15:07+02:00", "2026-02-28T22:15:07"),
        ] {
            let epoch = parse_utc(text).unwrap();
            assert_eq!(format_utc(epoch), written);
            assert_eq!(parse_utc(&format_utc(epoch)).unwrap(), epoch);
        }
    }

    #[test]
    fn a_leap_second_lies_between_its_neighbours() {
        let tai_s = |text| parse_utc(text).unwrap().to_tai_duration().to_seconds();
        let [before, leap, after] = ["2016-12-31T23:59:59Z", "2016-12-31T23:59:60Z", "2017-01-01T00:00:00Z"].map(tai_s);
        assert_eq!((leap - before, after - leap), (1.0, 1.0));
    }

    #[test]
    fn refuses_what_is_no_time() {
        for text in
            ["", "yesterday", "2019-07-29", "2019-13-29T20:47:26Z", "2019-02-30T20:47:26Z", "2019-07-29T24:47:26Z", "29.07.2019 20:47"]
        {
            assert!(parse_utc(text).unwrap_err().contains("is no time"), "{text}");
        }
    }

    #[test]
    fn terrestrial_time_runs_ahead_of_utc() {
        let tt = parse_in("2019-07-29T20:47:26", TimeScale::TT).unwrap();
        let utc = parse_utc("2019-07-29T20:47:26").unwrap();
        // 37 leap seconds and 32.184 s (IERS Bulletin C 57; IAU 1991 resolution A4)
        assert!(((utc - tt).to_seconds() - 69.184).abs() < 1e-9);
    }
}
