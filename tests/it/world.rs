//! World coordinates by a reader of the convention's own equations, written here anew: the place of a catalogue star at the frame's epoch leads to
//! the pixel on which the model has its image. astropy says the same of the same files (tests/interop).

use boresight::camera::Model;
use boresight::catalog::{Catalog, Star};
use boresight::coordinates::{Apparent, Attitude, Direction};
use boresight::effects::{Context, StarState};
use boresight::exchange::{Exported, Format, Places, Subject, SubjectFrame, export};
use boresight::scene::{Exposure, Scene, preset};

/// uⁱ·vʲ and its coefficient.
type Terms = Vec<(i32, i32, f64)>;

/// TAN-SIP as a header says it (Shupe et al. 2005, ASP Conf. 347, 491).
pub(crate) struct Header {
    cards: Vec<(String, String)>,
    crpix: [f64; 2],
    crval_rad: [f64; 2],
    cd_deg: [[f64; 2]; 2],
    a: Terms,
    b: Terms,
    ap: Terms,
    bp: Terms,
}

impl Header {
    pub(crate) fn read(bytes: &[u8]) -> Self {
        let card = |card: &[u8]| {
            let text = String::from_utf8(card.to_vec()).unwrap();
            let (key, value) = text.split_once("= ")?;
            Some((key.trim().to_owned(), value.trim().trim_matches('\'').trim().to_owned()))
        };
        let cards: Vec<(String, String)> = bytes.chunks(80).filter_map(card).collect();
        let number = |key: &str| cards.iter().find(|(own, _)| own == key).and_then(|(_, value)| value.parse::<f64>().ok());
        let terms = |name: &str| -> Terms {
            let each = (0..=9).flat_map(|i| (0..=9).map(move |j| (i, j)));
            each.filter_map(|(i, j)| Some((i, j, number(&format!("{name}_{i}_{j}"))?))).collect()
        };
        let [crpix, crval] = ["CRPIX", "CRVAL"].map(|key| [1, 2].map(|axis| number(&format!("{key}{axis}")).unwrap()));
        let cd_deg = [1, 2].map(|row| [1, 2].map(|column| number(&format!("CD{row}_{column}")).unwrap()));
        let [a, b, ap, bp] = ["A", "B", "AP", "BP"].map(terms);
        Self { crpix, crval_rad: crval.map(f64::to_radians), cd_deg, a, b, ap, bp, cards }
    }

    fn text(&self, key: &str) -> Option<&str> {
        self.cards.iter().find(|(own, _)| own == key).map(|(_, value)| value.as_str())
    }

    /// CD⁻¹ of the gnomonic projection of a place (right ascension and declination, degrees) about CRVAL.
    fn plane(&self, radec_deg: [f64; 2]) -> [f64; 2] {
        let [ra, dec] = radec_deg.map(f64::to_radians);
        let [ra0, dec0] = self.crval_rad;
        let ((sin, cos), (sin0, cos0)) = (dec.sin_cos(), dec0.sin_cos());
        let (sin_d, cos_d) = (ra - ra0).sin_cos();
        let depth = sin * sin0 + cos * cos0 * cos_d;
        let (xi, eta) = ((cos * sin_d / depth).to_degrees(), ((sin * cos0 - cos * sin0 * cos_d) / depth).to_degrees());
        let [[p, q], [r, s]] = self.cd_deg;
        let determinant = p * s - q * r;
        [(s * xi - q * eta) / determinant, (p * eta - r * xi) / determinant]
    }

    /// The pixel, counted from 0, on which A and B have a place: their inverse by iteration.
    pub(crate) fn pixel(&self, radec_deg: [f64; 2]) -> [f64; 2] {
        let target = self.plane(radec_deg);
        let mut point = target;
        for _ in 0..50 {
            let shift = [sum(&self.a, point), sum(&self.b, point)];
            point = [target[0] - shift[0], target[1] - shift[1]];
        }
        [point[0] + self.crpix[0] - 1.0, point[1] + self.crpix[1] - 1.0]
    }

    /// The same by AP and BP.
    fn quick_pixel(&self, radec_deg: [f64; 2]) -> [f64; 2] {
        let [u, v] = self.plane(radec_deg);
        [u + sum(&self.ap, [u, v]) + self.crpix[0] - 1.0, v + sum(&self.bp, [u, v]) + self.crpix[1] - 1.0]
    }
}

fn sum(terms: &Terms, [u, v]: [f64; 2]) -> f64 {
    terms.iter().map(|(i, j, c)| c * u.powi(*i) * v.powi(*j)).sum()
}

fn world(scene: &Scene, places: Places, format: Format) -> Exported {
    let frame = |(frame, exposure): (usize, std::sync::Arc<Exposure>)| SubjectFrame {
        frame,
        attitude: exposure.attitude,
        sky: Some(exposure.sky.clone()),
    };
    let physics = scene.exposures.get(0).sky.ids().into_iter().map(str::to_owned).collect();
    let frames = scene.exposures.iter().enumerate().map(frame).collect();
    export(&Subject { model: scene.model.clone(), parity: 1, physics, frames, places }, format).unwrap()
}

/// Where the model itself has a star's image in an exposure, if that is on the frame.
fn image(model: &Model, exposure: &Exposure, star: &Star, epoch_yr: f64) -> Option<[f64; 2]> {
    let context = Context::new(StarState::of(star, epoch_yr), *exposure.sky.observation());
    let seen: Direction<Apparent> = exposure.sky.apparent(star, epoch_yr);
    if Attitude::rows(&exposure.attitude)[2].iter().zip(seen.xyz).map(|(a, b)| a * b).sum::<f64>() < 0.5 {
        return None;
    }
    let point = model.pixel(&exposure.attitude.camera_from_apparent(&seen), &context)?;
    let [width, height] = [model.camera().width_px, model.camera().height_px].map(|side| side as f64 - 0.5);
    ((-0.5..width).contains(&point.x_px) && (-0.5..height).contains(&point.y_px)).then_some([point.x_px, point.y_px])
}

/// A lens 30° wide with the distortion of such a lens, low over the horizon.
const THIRTY_DEGREES: &str = r#"
format = "boresight-scene/1"
seed = 7
[camera]
width_px = 1600
height_px = 1200
focal_length_px = 2985.0
principal_point_px = [807.0, 590.5]
k1 = 1.3e-8
p1 = 2.0e-7
p2 = -3.0e-7
[[effects]]
id = "radial-high-order"
parameters = { k2_norm = 0.05, k3_norm = -0.2 }
[nominal]
focal_length_px = 2985.0
[detector]
psf_sigma_px = 1.0
zero_point_e_per_s = 2.0e6
gain_e_per_dn = 2.0
bias_dn = 200.0
read_noise_e = 5.0
saturation_dn = 65535.0
full_well_e = 1.0e5
[sky]
background_e_per_px_s = 25.0
faintest_magnitude = 7.0
physics = "known"
[site]
latitude_deg = 37.22
longitude_deg = -2.55
height_m = 2168.0
[series]
count = 4
start_utc = "2031-03-01T20:00:00Z"
interval_s = 3600.0
exposure_s = 0.1
lowest_altitude_deg = 28.0
"#;

#[test]
fn places_of_the_catalogue_lead_to_the_pixels_of_the_model() {
    let catalog = Catalog::embedded();
    let scenes = [
        ("the demo", Scene::demo().unwrap()),
        ("machine-vision-35mm", Scene::parse("preset", preset("machine-vision-35mm").unwrap().toml).unwrap()),
        ("30 degrees", Scene::parse("thirty", THIRTY_DEGREES).unwrap()),
    ];
    for (name, scene) in &scenes {
        let exported = world(scene, Places::Catalog, Format::Sip);
        let light = world(scene, Places::Apparent, Format::Sip);
        assert!(exported.expressible && exported.inverse_max_px.unwrap() < 0.01, "{name}: {exported:?}");
        let (mut stars, mut largest, mut quick, mut apparent) = (0, 0.0_f64, 0.0_f64, 0.0_f64);
        for (exposure, (file, of_light)) in scene.exposures.iter().zip(exported.files.iter().zip(&light.files)) {
            let (header, of_light) = (Header::read(&file.bytes), Header::read(&of_light.bytes));
            assert_eq!((header.text("RADESYS"), header.text("WCSNAME")), (Some("ICRS"), Some("ICRS PLACES")));
            assert_eq!(of_light.text("WCSNAME"), Some("APPARENT DIRECTIONS"));
            for star in &catalog.stars {
                let Some([x_px, y_px]) = image(&scene.model, &exposure, star, catalog.epoch_yr) else { continue };
                let (place, epoch_yr) = exposure.sky.place(star, catalog.epoch_yr);
                assert_eq!(Some(epoch_yr), exposure.sky.observation().epoch_yr);
                let [ra, dec] = [place.radec_rad().0, place.radec_rad().1].map(f64::to_degrees);
                let off = |[x, y]: [f64; 2]| (x - x_px).hypot(y - y_px);
                stars += 1;
                largest = largest.max(off(header.pixel([ra, dec])));
                quick = quick.max(off(header.quick_pixel([ra, dec])));
                apparent = apparent.max(off(of_light.pixel([ra, dec])));
            }
        }
        println!(
            "{name}: {} of {stars} stars {largest:.1e} px, by AP and BP {quick:.1e} px; of the light as it arrives {apparent:.2} px",
            exported.model
        );
        assert!(stars > 100 && largest <= 0.01 && quick <= 0.01, "{name}: {largest} px, {quick} px of {stars} stars");
        assert!(apparent > 0.1, "{name}: the light as it arrives is another thing");
    }
}

#[test]
fn tpv_maps_the_places_too() {
    let scene = Scene::parse("preset", preset("machine-vision-35mm").unwrap().toml).unwrap();
    let exported = world(&scene, Places::Catalog, Format::Tpv);
    assert!(exported.residual.max_px < 1e-3, "{exported:?}");
    assert_eq!(exported.files.len(), scene.exposures.len());
}

#[test]
fn what_nobody_says_of_the_light_is_not_made_up() {
    let scene = Scene::demo().unwrap();
    let frames = vec![SubjectFrame { frame: 0, attitude: scene.exposures.get(0).attitude, sky: None }];
    let subject =
        Subject { model: scene.model.clone(), parity: 1, physics: vec!["refraction".to_owned()], frames, places: Places::Catalog };
    let error = export(&subject, Format::Sip).unwrap_err().to_string();
    assert!(error.contains("--wcs apparent"), "{error}");
    assert!(export(&Subject { places: Places::Apparent, ..subject }, Format::Sip).is_ok());
}
