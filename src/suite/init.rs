//! `--init`: a suite to begin from, with the cases of ECSS-E-ST-60-20C (Rev. 2, 2019) for a scene: lost in space, slewing, tracking, errors split by cause,
//! stray light, radiation. The frames of each case are those that its limits need.

use super::verdict::{RequirementLimit, SampleKind, fewest_frames};
use crate::scene::Scene;
use crate::units::ARCSEC_RAD;

const CONFIDENCE: f64 = 0.95;

/// What a suite begins from.
#[derive(Clone, Debug)]
pub struct SuiteSource<'s> {
    /// The line of the case that names it: `preset = "…"` or `scene = "…"`.
    pub key: String,
    /// The scene.
    pub scene: &'s Scene,
    /// Whether its tables of a mount have to go, so that it can be pointed.
    pub is_fixed: bool,
}

/// A rate that is required, with the fewest frames that can show it.
fn frames(kind: SampleKind, limit: RequirementLimit) -> usize {
    fewest_frames(kind, limit, 1.0 - CONFIDENCE).unwrap_or(1)
}

/// The text of a suite.
#[must_use]
pub fn init_suite(source: &SuiteSource<'_>) -> String {
    let SuiteSource { key, scene, is_fixed } = source;
    let pixel_arcsec = 1.0 / scene.camera.focal_length_px / ARCSEC_RAD;
    let width_deg = 2.0 * (0.5 * scene.camera.width_px as f64 / scene.camera.focal_length_px).atan().to_degrees();
    // About the boresight a field of this size is worse by so much.
    let lever = (2.0 / width_deg.to_radians()).max(1.0);
    let tidy = |value: f64| {
        let step = 10.0_f64.powf(value.log10().floor());
        (value / step).ceil() * step
    };
    let (within, cross, about) = (tidy(3.0 * pixel_arcsec), tidy(0.5 * pixel_arcsec), tidy(0.5 * pixel_arcsec * lever));
    let head = if *is_fixed { format!("{key}\nset = {{ mount = false }}                     # the camera is pointed all over the sky") } else { key.clone() };
    let found = frames(SampleKind::Share, RequirementLimit::AtLeast(0.99));
    let wrong = frames(SampleKind::Share, RequirementLimit::AtMost(0.001));
    let p99 = frames(SampleKind::Quantile(0.99), RequirementLimit::AtMost(1.0));
    let slow = found.max(p99);
    let background = scene.sky.background_e_per_px_s.unwrap_or(1.0).max(1.0);
    let stray = [1.0, 10.0, 100.0].map(|factor| tidy(factor * background));
    let first = frames(SampleKind::Quantile(0.95), RequirementLimit::AtMost(1.0));
    format!(
        "# Requirements of a star tracker, in the terms of ECSS-E-ST-60-20C: `boresight test SUITE.toml -o DIR`. The limits are a proposal for this camera\n\
         # ({width_deg:.1} degrees wide, {pixel_arcsec:.1} arcsec a pixel): put your specification in their place. The numbers of frames are those that the limits need.\n\
         format = \"boresight-suite/1\"\n\
         seed = 1                                          # the same frames every time\n\
         confidence = {CONFIDENCE}\n\n\
         # Without [system] boresight itself is tested. Another program:\n\
         # [system]\n\
         # command = [\"./my_tracker\", \"--image\", \"{{image}}\", \"--out\", \"{{answer}}\"]\n\
         # mode = \"frame\"                                  # frame, batch, stream\n\
         # image = \"png8\"                                  # png8, png16, tiff16, fits, raw16\n\
         # answer = \"csv\"                                  # csv, json, lost, tetra3, astrometry-wcs\n\
         # [system.conventions]\n\
         # rotation = \"camera_from_icrs\"                   # or icrs_from_camera; `--guess-conventions` finds them\n\
         # quaternion = \"xyzw\"\n\
         # axes = \"x right, y down, z out\"\n\
         # pixel_origin = 0.0\n\n\
         [[case]]\n\
         name = \"autonomous attitude determination (lost in space)\"\n\
         {head}\n\
         frames = {slow}                                      # without a failure these show 99 % and the 99th percentile\n\
         attitudes = \"uniform\"\n\
         within_arcsec = {within}\n\
         [[case.require]]\n\
         metric = \"acquisition.correct_rate\"\n\
         at_least = 0.99\n\
         [[case.require]]\n\
         metric = \"attitude.cross_boresight_arcsec.p99\"\n\
         at_most = {within}\n\
         level = \"design\"\n\
         [[case.require]]\n\
         metric = \"crashes.rate\"\n\
         at_most = 0.01\n\n\
         [[case]]\n\
         name = \"no false attitudes\"\n\
         {head}\n\
         frames = \"auto\"                                   # until it is decided; 1 in 1000 takes {wrong} frames without a failure\n\
         max_frames = {most}\n\
         attitudes = \"uniform\"\n\
         within_arcsec = {within}\n\
         [[case.require]]\n\
         metric = \"acquisition.false_rate\"\n\
         at_most = 0.001\n\n\
         [[case]]\n\
         name = \"slewing\"\n\
         {head}\n\
         frames = {found}\n\
         within_arcsec = {within}\n\
         sweep = {{ path = \"frames.rate_deg_s[1]\", values = [0.0, 0.1, 0.3, 1.0], name = \"rate\" }}\n\
         [[case.require]]\n\
         metric = \"acquisition.correct_rate\"\n\
         at_least = 0.99\n\
         when = \"rate <= 0.1\"\n\
         [[case.require]]\n\
         metric = \"acquisition.correct_rate\"\n\
         at_least = 0.9\n\
         level = \"stretch\"\n\n\
         [[case]]\n\
         name = \"measurement error: bias, FOV spatial, pixel spatial, temporal noise\"\n\
         {head}\n\
         frames = 540                                      # 20 fields x 9 places within a pixel x 3 exposures\n\
         attitudes = {{ kind = \"nested\", grid = 3, repeats = 3 }}\n\
         within_arcsec = {within}\n\
         [[case.require]]\n\
         metric = \"ecss.cross_boresight_arcsec.bias\"\n\
         at_most = {cross}\n\
         [[case.require]]\n\
         metric = \"ecss.cross_boresight_arcsec.fov_spatial\"\n\
         at_most = {cross}\n\
         [[case.require]]\n\
         metric = \"ecss.cross_boresight_arcsec.pixel_spatial\"\n\
         at_most = {cross}\n\
         [[case.require]]\n\
         metric = \"ecss.cross_boresight_arcsec.temporal_noise\"\n\
         at_most = {cross}\n\
         [[case.require]]\n\
         metric = \"ecss.about_boresight_arcsec.temporal_noise\"\n\
         at_most = {about}\n\n\
         [[case]]\n\
         name = \"star tracking: first acquisition on a slow drift\"\n\
         {head}\n\
         frames = {tracked}\n\
         attitudes = {{ kind = \"scan\", step_px = 3.7, sequence = 5 }}\n\
         within_arcsec = {within}\n\
         [[case.require]]\n\
         metric = \"acquisition.first_frames.p95\"\n\
         at_most = 2\n\n\
         [[case]]\n\
         name = \"stray light\"\n\
         {head}\n\
         frames = {found}\n\
         within_arcsec = {within}\n\
         sweep = {{ path = \"sky.background_e_per_px_s\", values = [{}, {}, {}], name = \"background\" }}\n\
         [[case.require]]\n\
         metric = \"acquisition.correct_rate\"\n\
         at_least = 0.99\n\
         when = \"background <= {}\"\n\n\
         [[case]]\n\
         name = \"radiation\"\n\
         {head}\n\
         frames = {found}\n\
         within_arcsec = {within}\n\
         sweep = {{ path = \"cosmic_rays.expected_per_s\", values = [10.0, 100.0, 1000.0], name = \"particles_per_s\" }}\n\
         [[case.require]]\n\
         metric = \"acquisition.correct_rate\"\n\
         at_least = 0.99\n\
         when = \"particles_per_s <= 100\"\n",
        stray[0], stray[1], stray[2], stray[0],
        most = wrong * 2,
        tracked = 5 * first,
    )
}
