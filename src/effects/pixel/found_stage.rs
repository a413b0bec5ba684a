//! What `diagnose` finds, in the parameters of the stage that renders it: names that differ, and factors.

use super::{AnyPixelEffect, pixel_effect};
use crate::effects::sky::glow::sky_glow;

/// The square of an image's width grows by 1.03·s·N by its moments (page of brighter-fatter): its width by half of that.
const WIDTH_PER_SHIFT: f64 = 0.515;

/// The numbers of a detector that sizes are converted with.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DetectorScale {
    /// Electrons per count.
    pub gain_e_per_dn: f64,
    /// Electrons of a full pixel.
    pub full_well_e: f64,
    /// Pixels of the frame.
    pub pixels: f64,
}

/// The id of the stage that renders a finding.
#[must_use]
pub fn found_stage(id: &str) -> &str {
    match id {
        "adc" => "dnl",
        "compression" => "jpeg",
        id => id,
    }
}

/// The stage's parameter that a parameter of a finding stands for, and the factor; nothing where the stage has none.
#[must_use]
pub fn found_parameter(stage: &str, name: &str, scale: &DetectorScale) -> Option<(&'static str, f64)> {
    let per_million = 1e6 / scale.pixels;
    match (stage, name) {
        ("brighter-fatter", "relative_width_at_full") => return Some(("shift_px_per_e", (WIDTH_PER_SHIFT * scale.full_well_e).recip())),
        ("banding", "row_sigma_dn") => return Some(("row_sigma_e", scale.gain_e_per_dn)),
        ("banding", "column_sigma_dn") => return Some(("column_sigma_e", scale.gain_e_per_dn)),
        ("amplifier-step", "offset_dn") => return Some(("offset_e", scale.gain_e_per_dn)),
        ("amplifier-step", "offset_right_dn") => return Some(("offset_right_e", scale.gain_e_per_dn)),
        ("stray-light", "slope_x_dn_per_px_s") => return Some(("slope_x_e_per_px_s", scale.gain_e_per_dn)),
        ("stray-light", "slope_y_dn_per_px_s") => return Some(("slope_y_e_per_px_s", scale.gain_e_per_dn)),
        ("even-odd", "relative") => return Some(("gain_relative", 1.0)),
        ("hot-pixels", "count") => return Some(("hot_per_million", per_million)),
        ("hot-pixels", "dead_count") => return Some(("dead_per_million", per_million)),
        ("random-telegraph", "count") => return Some(("rts_per_million", per_million)),
        _ => {}
    }
    let specs = pixel_effect(stage).map(AnyPixelEffect::parameters);
    let same = specs.into_iter().flatten().find(|spec| spec.name == name).map(|spec| (spec.name, 1.0));
    same.or_else(|| (sky_glow(stage).is_some() && name == "relative").then_some(("relative", 1.0)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_become_those_of_the_stage() {
        let scale = DetectorScale { gain_e_per_dn: 2.0, full_well_e: 1e5, pixels: 5e5 };
        let of = |id: &str, name: &str| found_parameter(found_stage(id), name, &scale);
        assert_eq!(of("vignetting", "loss_at_corner"), Some(("loss_at_corner", 1.0)));
        assert_eq!(of("banding", "row_sigma_dn"), Some(("row_sigma_e", 2.0)));
        assert_eq!(of("stray-light", "slope_y_dn_per_px_s"), Some(("slope_y_e_per_px_s", 2.0)));
        assert_eq!(of("hot-pixels", "count"), Some(("hot_per_million", 2.0)));
        assert_eq!(of("adc", "dnl_dn"), Some(("dnl_dn", 1.0)));
        assert_eq!(of("adc", "lost_bits"), None);
        assert_eq!(of("brighter-fatter", "variance_lost_at_full"), None);
        assert_eq!(of("compression", "table_scale_dn"), Some(("table_scale_dn", 1.0)));
        assert_eq!(of("zodiacal-light", "relative"), Some(("relative", 1.0)));
    }
}
