//! `[detector]`: parameters from light to counts.

use super::{ColourFiltersTable, DetectorTable, QuantumEfficiencyTable, SceneError};
use crate::effects::detector::adc::full_scale_dn;
use crate::effects::detector::colour_filters::FilterResponse;
use crate::effects::detector::quantum_efficiency::{ColourResponse, ResponseCurve};

impl ColourFiltersTable {
    /// The responses of the pixels behind the filters.
    #[must_use]
    pub fn response(&self, camera: Option<&QuantumEfficiencyTable>) -> FilterResponse {
        if let Some(relative_per_mag) = self.relative_per_mag {
            return FilterResponse::Slope { relative_per_mag };
        }
        let curve = |values: &[f64]| match camera {
            Some(camera) => camera.behind(&self.wavelengths_nm, values),
            None => ResponseCurve::new(&self.wavelengths_nm, values),
        };
        FilterResponse::Curves(Box::new([curve(&self.red), curve(&self.green), curve(&self.blue)]))
    }
}

impl QuantumEfficiencyTable {
    /// The product of the two curves.
    fn curve(&self) -> ResponseCurve {
        let with = |place: usize, value: f64| value * self.transmission.as_ref().map_or(1.0, |values| values[place]);
        let values: Vec<f64> = self.values.iter().enumerate().map(|(place, value)| with(place, *value)).collect();
        ResponseCurve::new(&self.wavelengths_nm, &values)
    }

    /// The camera's response behind a filter: the product of the lines, in steps that are fine enough for the product to be straight.
    fn behind(&self, wavelengths_nm: &[f64], filter: &[f64]) -> ResponseCurve {
        const STEP_NM: f64 = 2.0;
        let mut all: Vec<f64> = self.wavelengths_nm.iter().chain(wavelengths_nm).copied().collect();
        let [low, high] = [all.iter().copied().fold(f64::INFINITY, f64::min), all.iter().copied().fold(0.0, f64::max)];
        all.extend((1..((high - low) / STEP_NM).ceil() as usize).map(|step| low + STEP_NM * step as f64));
        all.sort_by(f64::total_cmp);
        all.dedup();
        let values: Vec<f64> = all.iter().map(|at| self.at(*at) * line(wavelengths_nm, filter, *at)).collect();
        ResponseCurve::new(&all, &values)
    }

    /// The product of the two curves at a wavelength.
    fn at(&self, wavelength_nm: f64) -> f64 {
        let transmission = self.transmission.as_ref().map_or(1.0, |values| line(&self.wavelengths_nm, values, wavelength_nm));
        line(&self.wavelengths_nm, &self.values, wavelength_nm) * transmission
    }
}

/// The height of a line through points at a place; nothing beyond its ends.
fn line(places: &[f64], heights: &[f64], at: f64) -> f64 {
    places
        .windows(2)
        .zip(heights.windows(2))
        .find(|(ends, _)| (ends[0]..=ends[1]).contains(&at))
        .map_or(0.0, |(ends, heights)| heights[0] + (heights[1] - heights[0]) * (at - ends[0]) / (ends[1] - ends[0]))
}

impl DetectorTable {
    /// The count of a full pixel: where the converter or the pixel itself ends.
    #[must_use]
    pub fn full_pixel_dn(&self) -> f64 {
        self.top_dn().min((self.bias_dn + self.full_well_e / self.gain_e_per_dn).floor())
    }

    /// The highest count of the converter.
    #[must_use]
    pub fn top_dn(&self) -> f64 {
        self.saturation_dn.unwrap_or_else(|| full_scale_dn(f64::from(self.bits)))
    }

    /// How the electrons of a star follow its colour.
    #[must_use]
    pub fn colour_response(&self) -> ColourResponse {
        match (&self.quantum_efficiency, self.colour_term_mag_per_mag) {
            (Some(table), _) => ColourResponse::Curve(table.curve()),
            (None, Some(mag_per_mag)) => ColourResponse::Term { mag_per_mag },
            (None, None) => ColourResponse::Grey,
        }
    }
}

/// Checks every number against its range.
pub(super) fn check(path: &str, detector: &DetectorTable) -> Result<(), SceneError> {
    let refuse = |name: &str, value: String, remedy: &'static str| -> Result<(), SceneError> {
        Err(SceneError::Value { path: path.to_owned(), key: format!("detector.{name}"), value, remedy })
    };
    let above_0 = [
        ("psf_sigma_px", detector.psf_sigma_px),
        ("zero_point_e_per_s", detector.zero_point_e_per_s),
        ("gain_e_per_dn", detector.gain_e_per_dn),
        ("full_well_e", detector.full_well_e),
    ];
    for (name, value) in above_0 {
        if !(value.is_finite() && value > 0.0) {
            return refuse(name, value.to_string(), "must be a number above 0");
        }
    }
    for (name, value) in [("bias_dn", detector.bias_dn), ("read_noise_e", detector.read_noise_e)] {
        if !(value.is_finite() && value >= 0.0) {
            return refuse(name, value.to_string(), "must be a number not below 0");
        }
    }
    // An opening of forty metres, of all colours; what holds more electrons is no pixel.
    for (name, value, most) in [("zero_point_e_per_s", detector.zero_point_e_per_s, 1e14), ("full_well_e", detector.full_well_e, 1e12)] {
        if value > most {
            return refuse(name, value.to_string(), "must not be above 1e14 (zero_point_e_per_s) or 1e12 (full_well_e)");
        }
    }
    if !(0.2..=20.0).contains(&detector.psf_sigma_px) {
        return refuse("psf_sigma_px", detector.psf_sigma_px.to_string(), "must lie between 0.2 and 20");
    }
    if !(8..=16).contains(&detector.bits) {
        return refuse("bits", detector.bits.to_string(), "must lie between 8 and 16");
    }
    let top_dn = detector.top_dn();
    if !(top_dn <= full_scale_dn(f64::from(detector.bits)) && top_dn > detector.bias_dn) {
        let remedy = "must put the converter's top above detector.bias_dn and not above 2^bits - 1 (65535 where no bits are given)";
        return match detector.saturation_dn {
            Some(_) => refuse("saturation_dn", top_dn.to_string(), remedy),
            None => refuse("bits", detector.bits.to_string(), remedy),
        };
    }
    check_colours(path, detector)?;
    check_filters(path, detector)
}

/// What the electrons have to do with the star's colour.
fn check_colours(path: &str, detector: &DetectorTable) -> Result<(), SceneError> {
    let refuse = |key: &str, value: String, remedy: &'static str| -> Result<(), SceneError> {
        Err(SceneError::Value { path: path.to_owned(), key: format!("detector.{key}"), value, remedy })
    };
    if let Some(term) = detector.colour_term_mag_per_mag.filter(|term| !(-2.0..=2.0).contains(term)) {
        return refuse("colour_term_mag_per_mag", term.to_string(), "must lie between -2 and 2");
    }
    let Some(table) = &detector.quantum_efficiency else { return Ok(()) };
    if detector.colour_term_mag_per_mag.is_some() {
        return refuse("colour_term_mag_per_mag", "given".into(), "stands beside [detector.quantum_efficiency]: keep one of the two");
    }
    check_curve(&table.wavelengths_nm, [("values", Some(&table.values)), ("transmission", table.transmission.as_ref())])
        .or_else(|(name, value, remedy)| refuse(&format!("quantum_efficiency.{name}"), value, remedy))?;
    let seen = |place: usize| table.values[place] * table.transmission.as_ref().map_or(1.0, |values| values[place]);
    if (0..table.values.len()).all(|place| seen(place) == 0.0) {
        return refuse("quantum_efficiency.values", "0 everywhere".into(), "must let some light through");
    }
    Ok(())
}

/// What filters share of it.
fn check_filters(path: &str, detector: &DetectorTable) -> Result<(), SceneError> {
    let Some(table) = &detector.colour_filters else { return Ok(()) };
    let refuse = |name: &str, value: String, remedy: &'static str| -> Result<(), SceneError> {
        Err(SceneError::Value { path: path.to_owned(), key: format!("detector.colour_filters.{name}"), value, remedy })
    };
    let curves = [("red", &table.red), ("green", &table.green), ("blue", &table.blue)];
    if let Some(share) = table.relative_per_mag {
        if curves.iter().any(|(_, values)| !values.is_empty()) || !table.wavelengths_nm.is_empty() {
            return refuse("relative_per_mag", "given".into(), "stands beside curves: keep one of the two");
        }
        if !(-1.0..=1.0).contains(&share) {
            return refuse("relative_per_mag", share.to_string(), "must lie between -1 and 1");
        }
        return Ok(());
    }
    check_curve(&table.wavelengths_nm, curves.map(|(name, values)| (name, Some(values))))
        .or_else(|(name, value, remedy)| refuse(name, value, remedy))?;
    if table
        .response(detector.quantum_efficiency.as_ref())
        .white()
        .is_some_and(|white| !white.iter().all(|share| (0.0..=10.0).contains(share)))
    {
        return refuse("green", format!("{:?}", table.green), "must let a tenth of what red and blue ones count through, or more");
    }
    Ok(())
}

/// A curve's points: what is wrong with which of them.
fn check_curve<const N: usize>(
    wavelengths_nm: &[f64],
    curves: [(&'static str, Option<&Vec<f64>>); N],
) -> Result<(), (&'static str, String, &'static str)> {
    let is_in_range = |value: &f64| (100.0..=20_000.0).contains(value);
    if wavelengths_nm.len() < 2 || !wavelengths_nm.iter().all(is_in_range) || !wavelengths_nm.is_sorted_by(|a, b| a < b) {
        let remedy = "must be two wavelengths or more, increasing, between 100 and 20000 nm";
        return Err(("wavelengths_nm", format!("{wavelengths_nm:?}"), remedy));
    }
    for (name, values) in curves {
        let Some(values) = values else { continue };
        if values.len() != wavelengths_nm.len() {
            return Err((name, format!("{} numbers", values.len()), "must be as many as wavelengths_nm"));
        }
        if let Some(bad) = values.iter().find(|value| !(0.0..=1.0).contains(*value)) {
            return Err((name, bad.to_string(), "must hold numbers between 0 and 1 only"));
        }
    }
    Ok(())
}
