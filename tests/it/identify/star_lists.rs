//! Star lists with every nuisance that real images bring, and what a right answer is: for the tests and, by way of `#[path]`, for
//! `benches/identify.rs`.

use boresight::camera::{Camera, Model};
use boresight::catalog::Catalog;
use boresight::coordinates::{Attitude, Direction};
use boresight::detect::{Detection, Detections, Flags};
use boresight::identify::{IdentifyOptions, Projection, Solution};
use boresight::units::DEG_RAD;
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, Normal};
use rand_pcg::Pcg64Mcg;
use rustix::time::{ClockId, clock_gettime};

pub(crate) const WIDTH_PX: usize = 1024;
/// Scatter of the measured magnitudes, as between two passbands.
pub(crate) const MAGNITUDE_SIGMA: f64 = 0.2;
/// A right answer is nearer than this to the truth.
pub(crate) const RIGHT_DEG: f64 = 0.2;

/// What is done to a star list.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Scene {
    /// The angle from the left to the right edge.
    pub(crate) width_deg: f64,
    pub(crate) projection: Projection,
    /// Width over height.
    pub(crate) aspect: f64,
    /// The faintest star, V.
    pub(crate) faintest: f64,
    pub(crate) noise_px: f64,
    /// Radial displacement in the corner; its sign changes from trial to trial.
    pub(crate) corner_px: f64,
    pub(crate) false_stars: usize,
    /// The share of the stars that are not there.
    pub(crate) missing: f64,
    /// Only so many stars, the brightest.
    pub(crate) brightest: usize,
    pub(crate) mirrored: bool,
    /// Points by chance, from 4 to 200, and no star.
    pub(crate) star_free: bool,
}

pub(crate) const BASE: Scene = Scene {
    width_deg: 15.0,
    projection: Projection::Pinhole,
    aspect: 1.0,
    faintest: 6.0,
    noise_px: 0.1,
    corner_px: 0.0,
    false_stars: 0,
    missing: 0.0,
    brightest: usize::MAX,
    mirrored: false,
    star_free: false,
};

/// What is told of the focal length.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Told {
    /// Nothing: all fields from 3° to 90° are searched.
    Nothing,
    /// A value that is wrong by at most this share, by chance; it is trusted so far.
    Within(f64),
    /// A value that is wrong by this factor, up and down in turn, and how far it is trusted.
    Off(f64, f64),
}

/// A star list with its truth.
pub(crate) struct List {
    pub(crate) detections: Detections,
    /// Index of the catalogue star behind each detection.
    pub(crate) names: Vec<Option<usize>>,
    pub(crate) attitude: Attitude,
    pub(crate) focal_px: f64,
    /// The focal length as it is told, and its tolerance.
    pub(crate) prior: Option<(f64, f64)>,
}

pub(crate) fn detection(x_px: f64, y_px: f64, flux_dn: f64) -> Detection {
    Detection {
        x_px,
        y_px,
        covariance_px2: [0.01, 0.0, 0.01],
        flux_dn,
        flux_sigma_dn: flux_dn.abs().sqrt(),
        background_dn: 100.0,
        background_gradient_dn: [0.03, -0.04],
        width_px: 1.0,
        moments: None,
        chi2_per_dof: 1.0,
        peak_dn: flux_dn / 6.0,
        flags: Flags::default(),
    }
}

fn flux_dn(magnitude: f64) -> f64 {
    1e5 * 10_f64.powf(-0.4 * magnitude)
}

/// The list that a camera of this scene would give; another for every trial.
pub(crate) fn make(scene: &Scene, told: Told, trial: u64) -> List {
    let mut rng = Pcg64Mcg::seed_from_u64(trial);
    let (width, height) = (WIDTH_PX as f64, (WIDTH_PX as f64 / scene.aspect).floor());
    let half_rad = scene.width_deg * DEG_RAD / 2.0;
    let half = match scene.projection {
        Projection::Pinhole => half_rad.tan(),
        Projection::Equidistant => half_rad,
        Projection::Equisolid => 2.0 * (half_rad / 2.0).sin(),
        Projection::Stereographic => 2.0 * (half_rad / 2.0).tan(),
    };
    let focal_px = width / 2.0 / half;
    let corner_px = width.hypot(height) / 2.0;
    let k1 = if trial.is_multiple_of(2) { 1.0 } else { -1.0 } * scene.corner_px / corner_px.powi(3);
    let camera = Camera { k1, ..Camera::pinhole(WIDTH_PX, height as usize, focal_px) };
    let mut turn = || rng.random_range(0.0..360.0) * DEG_RAD;
    let (ra, roll) = (turn(), turn());
    let model = Model::new(camera).with_projection(scene.projection.id(), &[]).unwrap();
    let context = model.reference_context();
    // Fisheyes see as far as to the edges of the frame, and nothing in its corners.
    let least_z = if scene.projection == Projection::Pinhole { 0.0 } else { half_rad.cos() };
    let attitude = Attitude::from_pointing(ra, rng.random_range(-1.0_f64..1.0).asin(), roll);
    let prior = match told {
        Told::Nothing => None,
        Told::Within(share) => Some((focal_px * ((1.0 + share).ln() * rng.random_range(-1.0..1.0)).exp(), share)),
        Told::Off(factor, tolerance) => Some((if trial.is_multiple_of(2) { focal_px * factor } else { focal_px / factor }, tolerance)),
    };
    let normal = Normal::new(0.0, 1.0).unwrap();
    let mut stars = Vec::new();
    let catalog = Catalog::embedded().stars.iter().enumerate();
    for (name, star) in catalog.take_while(|(_, star)| star.magnitude < scene.faintest && !scene.star_free) {
        let direction = attitude.camera_from_apparent(&Direction::from_unit(star.direction.xyz));
        let seen = Some(direction).filter(|direction| direction.xyz[2] > least_z).and_then(|direction| model.pixel(&direction, &context));
        let Some(point) = seen.filter(|point| camera.contains(*point)) else { continue };
        if rng.random_range(0.0..1.0) < scene.missing {
            continue;
        }
        let magnitude = star.magnitude + MAGNITUDE_SIGMA * normal.sample(&mut rng);
        let mut noise = || scene.noise_px * normal.sample(&mut rng);
        stars.push((detection(point.x_px + noise(), point.y_px + noise(), flux_dn(magnitude)), Some(name)));
    }
    stars.truncate(scene.brightest);
    for _ in 0..if scene.star_free { rng.random_range(4..=200) } else { scene.false_stars } {
        let (x, y) = (rng.random_range(-0.5..width - 0.5), rng.random_range(-0.5..height - 0.5));
        stars.push((detection(x, y, flux_dn(rng.random_range(1.0..scene.faintest))), None));
    }
    if scene.mirrored {
        for (star, _) in &mut stars {
            star.x_px = width - 1.0 - star.x_px;
        }
    }
    stars.sort_by(|(a, _), (b, _)| b.flux_dn.total_cmp(&a.flux_dn));
    let (stars, names) = stars.into_iter().unzip();
    let detections = Detections { width_px: WIDTH_PX, height_px: height as usize, background_dn: 100.0, noise_dn: 3.0, stars };
    List { detections, names, attitude, focal_px, prior }
}

/// Lists of which nothing can be right: whatever is found is found by chance.
#[derive(Clone, Copy, Debug)]
pub(crate) enum ByChance {
    /// 6 to 50 points, fields 4° to 60° wide, the focal length known to 1 %.
    Few,
    /// 4 to 200 points, 15° wide, the focal length known to 10 %.
    Points,
    /// The same, and nothing known of the focal length.
    #[allow(dead_code, reason = "too long for the tests: the benchmark takes them")]
    PointsOfAnyField,
    /// The stars of an image 20° wide that is stretched by a third to a half along some direction: clusters and gaps are those of the sky.
    StretchedStars,
}

impl ByChance {
    /// A list with its search; another for every trial.
    pub(crate) fn list(self, trial: u64) -> (Detections, IdentifyOptions) {
        let points = Scene { star_free: true, ..BASE };
        let of = |list: List| {
            let options = list.options();
            (list.detections, options)
        };
        match self {
            Self::Few => {
                let mut list = make(&Scene { aspect: 4.0 / 3.0, faintest: 7.0, ..points }, Told::Nothing, trial).detections;
                list.stars.truncate(6 + (trial % 45) as usize);
                let width_rad = 4.0 * 15_f64.powf((trial % 23) as f64 / 22.0) * DEG_RAD;
                let options = IdentifyOptions {
                    nominal_focal_length_px: Some(WIDTH_PX as f64 / 2.0 / (width_rad / 2.0).tan()),
                    focal_length_tolerance: 0.01,
                    search_beyond_tolerance: false,
                    ..IdentifyOptions::default()
                };
                (list, options)
            }
            Self::Points => of(make(&points, Told::Within(0.1), trial)),
            Self::PointsOfAnyField => of(make(&points, Told::Nothing, trial)),
            Self::StretchedStars => {
                let scene = Scene { faintest: 6.5, noise_px: 0.5, width_deg: 20.0, ..BASE };
                let (mut list, options) = of(make(&scene, Told::Within(0.02), trial));
                let mut rng = Pcg64Mcg::seed_from_u64(!trial);
                let (more, along_rad) = (rng.random_range(0.33..0.5), rng.random_range(0.0..std::f64::consts::PI));
                let (along_y, along_x) = along_rad.sin_cos();
                let middle_px = (WIDTH_PX as f64 - 1.0) / 2.0;
                for star in &mut list.stars {
                    let along = more * ((star.x_px - middle_px) * along_x + (star.y_px - middle_px) * along_y);
                    (star.x_px, star.y_px) = (star.x_px + along * along_x, star.y_px + along * along_y);
                }
                let inside = |c: f64| c > -0.5 && c < WIDTH_PX as f64 - 0.5;
                list.stars.retain(|star| inside(star.x_px) && inside(star.y_px));
                // The focal length that its scale tells on the mean.
                let nominal_focal_length_px = options.nominal_focal_length_px.map(|f| f * (1.0 + more / 2.0));
                (list, IdentifyOptions { nominal_focal_length_px, ..options })
            }
        }
    }
}

impl List {
    /// The search that this list asks for.
    pub(crate) fn options(&self) -> IdentifyOptions {
        let own = IdentifyOptions::default();
        let (nominal_focal_length_px, focal_length_tolerance) = self.prior.unzip();
        IdentifyOptions {
            nominal_focal_length_px,
            focal_length_tolerance: focal_length_tolerance.unwrap_or(own.focal_length_tolerance),
            search_beyond_tolerance: false,
            ..own
        }
    }

    /// The angle between the middle of the frame and where it is said to be, rad.
    pub(crate) fn off_rad(&self, centre: &Direction<boresight::coordinates::Apparent>) -> f64 {
        self.attitude.apparent_from_camera(&Direction::from_unit([0.0, 0.0, 1.0])).angle_rad(centre)
    }

    /// Whether middle, roll and handedness are right.
    pub(crate) fn is_right(&self, scene: &Scene, solution: &Solution) -> bool {
        let up = |attitude: &Attitude| attitude.apparent_from_camera(&Direction::from_unit([0.0, -1.0, 0.0]));
        !scene.star_free
            && self.off_rad(&solution.centre()) < RIGHT_DEG * DEG_RAD
            && up(&self.attitude).angle_rad(&up(&solution.attitude)) < DEG_RAD
            && (solution.parity < 0) == scene.mirrored
    }

    /// The matches whose detection is another star, or none.
    pub(crate) fn misnamed(&self, solution: &Solution) -> usize {
        solution.matches.iter().filter(|one| self.names[one.detection] != Some(one.star)).count()
    }
}

/// CPU time of this thread, ms: the same on a machine that has other work to do.
pub(crate) fn cpu_ms() -> f64 {
    let now = clock_gettime(ClockId::ThreadCPUTime);
    1e3 * now.tv_sec as f64 + 1e-6 * now.tv_nsec as f64
}
