//! `[camera.binning]`: binned pixels, and which parameters are of them.
//!
//! The scene describes the frame that is read out: lengths and places in `[camera]`, `[nominal]`, `[psf]`, of the sky and of other lights are those
//! of binned pixels, and so are those of the truth. Parameters in `[detector]` (full well, read noise, gain, bias, bits), the response within a
//! pixel (`[psf.pixel]`) and every effect on pixels in `[[effects]]` are of the detector's own pixels, n × n of them in each binned one; what
//! follows the amplifier, where charge is joined before it, sees binned ones.

use super::{BinningMethod, BinningSite, BinningTable, DetectorTable, SceneError, TrueCameraTable};
use crate::imaging::{Binning, BinningPlace};

impl BinningTable {
    /// As the imager takes it.
    pub(super) fn binning(self) -> Binning {
        let place = match self.place {
            BinningSite::OnChip => BinningPlace::OnChip,
            BinningSite::Digital => BinningPlace::Digital,
        };
        Binning { factor: self.factor, is_mean: self.method == BinningMethod::Mean, place }
    }
}

/// Checks the table.
pub(super) fn check(path: &str, camera: &TrueCameraTable, detector: &DetectorTable) -> Result<(), SceneError> {
    /// Native pixels along a side.
    const MAX_PX: usize = 32_768;
    let Some(table) = camera.binning else { return Ok(()) };
    let refuse = |name: &str, value: String, remedy: &'static str| {
        Err(SceneError::Value { path: path.to_owned(), key: format!("camera.binning.{name}"), value, remedy })
    };
    if !(2..=4).contains(&table.factor) {
        return refuse("factor", table.factor.to_string(), "must be 2, 3 or 4; leave [camera.binning] out for pixels as they are");
    }
    if camera.width_px.max(camera.height_px) * table.factor > MAX_PX {
        return refuse("factor", table.factor.to_string(), "must not make more than 32768 of the detector's own pixels along a side");
    }
    let binning = table.binning();
    if binning.place == BinningPlace::Digital && binning.pixels() * binning.share() * detector.top_dn() > 65_535.0 {
        let remedy = "must not make sums beyond 16 bits: choose method = \"mean\", fewer detector.bits or a lower detector.saturation_dn";
        return refuse("factor", table.factor.to_string(), remedy);
    }
    Ok(())
}

impl DetectorTable {
    /// The detector as its joined pixels show it: what a recording of them declares. Electrons are those of the light, however they are counted.
    #[must_use]
    pub fn joined(&self, binning: Option<Binning>) -> Self {
        let Some(binning) = binning else { return self.clone() };
        let (pixels, share) = (binning.pixels(), binning.share());
        let joined = Self {
            gain_e_per_dn: self.gain_e_per_dn / share,
            full_well_e: self.full_well_e * pixels,
            read_noise_e: self.read_noise_e * binning.read_noise_factor(),
            ..self.clone()
        };
        match binning.place {
            BinningPlace::OnChip => joined,
            BinningPlace::Digital => Self {
                bias_dn: self.bias_dn * pixels * share,
                saturation_dn: Some((self.full_pixel_dn() * pixels * share).min(65_535.0)),
                ..joined
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Gain, bias, noise and full pixel of the joined pixel by hand: 2 e-/DN, bias 100 DN, 5 e- of read noise, full at 10 000 e-, 14 bits.
    #[test]
    fn a_joined_pixel_is_what_its_pixels_make() {
        let detector =
            DetectorTable { gain_e_per_dn: 2.0, bias_dn: 100.0, read_noise_e: 5.0, bits: 14, full_well_e: 1e4, ..DetectorTable::default() };
        for (is_mean, place, [gain, bias, noise, full]) in [
            (false, BinningPlace::OnChip, [2.0, 100.0, 5.0, 16_383.0]), // four full wells are 20 000 counts
            (true, BinningPlace::OnChip, [8.0, 100.0, 20.0, 5100.0]),
            (false, BinningPlace::Digital, [2.0, 400.0, 10.0, 20_400.0]),
            (true, BinningPlace::Digital, [8.0, 100.0, 10.0, 5100.0]),
        ] {
            let joined = detector.joined(Some(Binning { factor: 2, is_mean, place }));
            let found = [joined.gain_e_per_dn, joined.bias_dn, joined.read_noise_e, joined.full_pixel_dn()];
            assert_eq!(found, [gain, bias, noise, full], "{place:?}, mean: {is_mean}");
        }
        assert_eq!(detector.joined(None).full_pixel_dn(), 5100.0);
    }
}
