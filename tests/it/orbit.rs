//! A camera in orbit: from `[orbit]` of a scene to the velocity of each exposure.

use boresight::scene::Scene;

const TLE: &str = "tle = [\"1 00005U 58002B   00179.78495062  .00000023  00000-0  28098-4 0  4753\", \
                   \"2 00005  34.2682 348.7242 1859667 331.7664  19.3264 10.82419157413667\"]";

fn text(orbit: &str, frame: &str) -> String {
    format!(
        "format = \"boresight-scene/1\"\n[camera]\nwidth_px = 120\nheight_px = 90\nfocal_length_px = 300.0\n[orbit]\n{orbit}\n\
         [[frames]]\nexposure_s = 1.0\nboresight_radec_deg = [10.0, 20.0]\n{frame}\n"
    )
}

fn velocity(text: &str) -> [f64; 3] {
    let scene = Scene::parse("test.toml", text).unwrap_or_else(|error| panic!("{error}"));
    let exposure = &*scene.exposures.get(0);
    assert_eq!(exposure.telemetry.velocity_km_s, exposure.sky.observation().velocity_km_s);
    exposure.telemetry.velocity_km_s.unwrap()
}

/// Sum of the velocities that astropy 8.0.2 gives for the Earth (its own ephemeris) and for the satellite (sgp4 2.27, TEME to GCRS).
#[test]
fn a_satellite_moves_with_the_earth_and_about_it() {
    let found = velocity(&text(TLE, "time_utc = \"2000-06-28T00:50:19.733571Z\""));
    let expected = [29.125_042_434_7 + 4.741_397_514_5, 3.041_976_400_2 - 4.152_290_661_7, 1.318_054_076_4 - 2.094_107_062_7];
    for axis in 0..3 {
        assert!((found[axis] - expected[axis]).abs() < 1e-6, "{found:?} for {expected:?}");
    }
    // The same orbit from a state of the same moment, and a minute of its own.
    let state = "epoch_utc = \"2000-06-28T00:50:19.733571Z\"\nposition_km = [-7154.505595, -3782.318346, -3536.152687]\n\
                 velocity_km_s = [4.7413975145, -4.1522906617, -2.0941070627]";
    let [by_state, by_elements] = [state, TLE].map(|orbit| velocity(&text(orbit, "time_utc = \"2000-06-28T00:51:19.733571Z\"")));
    for axis in 0..3 {
        assert!((by_state[axis] - by_elements[axis]).abs() < 2e-3, "{by_state:?} for {by_elements:?}");
        assert!((by_state[axis] - found[axis]).abs() > 1e-2);
    }
}

#[test]
fn what_an_orbit_cannot_be_is_said() {
    let timed = "time_utc = \"2000-06-28T00:50:19Z\"";
    let site = format!("{timed}\n[site]\nlatitude_deg = 10.0\nlongitude_deg = 20.0");
    let fixed = format!("{timed}\n[mount]\nkind = \"fixed\"");
    let own = format!("{timed}\nvelocity_km_s = [1.0, 2.0, 3.0]");
    let wrong_sum = TLE.replace("4753", "4754");
    for (orbit, frame, words) in [
        (TLE, "", "orbit = given needs the time of every exposure"),
        (TLE, site.as_str(), "orbit = given stands beside a [site]"),
        (TLE, fixed.as_str(), "orbit = given stands beside a mount"),
        (TLE, own.as_str(), "frames[0].velocity_km_s = given stands beside an [orbit]"),
        (wrong_sum.as_str(), timed, "orbit.tle: these are no two-line elements"),
        ("position_km = [7000.0, 0.0, 0.0]", timed, "orbit: give either tle, or all of"),
        (
            "epoch_utc = \"noon\"\nposition_km = [7000.0, 0.0, 0.0]\nvelocity_km_s = [0.0, 7.5, 0.0]",
            timed,
            "orbit.epoch_utc = \"noon\" is no time",
        ),
        ("tel = 1", timed, "did you mean tle?"),
    ] {
        let error = Scene::parse("test.toml", &text(orbit, frame)).unwrap_err().to_string();
        assert!(error.contains(words) && error.starts_with("test.toml: ") && !error.contains('\n'), "{error}");
    }
}
