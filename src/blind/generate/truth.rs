//! What is true of a concealed recording, as it stands in its sealed file.

use serde::{Deserialize, Serialize};

use super::family::{Family, Trap};
use super::images::kind::Reckoned;
use super::kind::{Hidden, TrueParameter};
use super::limit::Fisher;
use super::shape::offers;
use super::world::World;

/// The format of a truth file.
pub const TRUTH_FORMAT: &str = "boresight-blind-truth/1";
/// Cosines below this are not written.
const ALIKE_FROM: f64 = 0.3;
/// The size that is just seen, standard errors.
const JUST_SEEN: f64 = 5.0;

/// Another effect that could stand in for the hidden one.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Alike {
    /// Its id.
    pub id: String,
    /// Cosine of the angle between the hidden displacement and what the other can offer.
    pub cos: f64,
}

/// An effect that is hidden.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TrueEffect {
    /// Its id.
    pub id: String,
    /// Its name in tables.
    pub label: String,
    /// Whether a library can hold it.
    pub in_library: bool,
    /// Its parameters.
    pub parameters: Vec<TrueParameter>,
    /// Signal-to-noise ratio of what attitudes and camera leave, with the true errors.
    pub snr: f64,
    /// The same over 5.
    pub multiple: f64,
    /// rms displacement, px (2-D).
    pub raw_rms_px: f64,
    /// Share that is left.
    pub survival: f64,
    /// Right answers to "where?".
    pub covariates: Vec<String>,
    /// Effects that look like it in this recording.
    pub alike: Vec<Alike>,
    /// How its size is reckoned, where it is hidden in pixels.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reckoned: Option<Reckoned>,
}

/// The camera, as it is.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TrueCamera {
    /// x0, y0, f, k1, p1, p2.
    pub parameters: [f64; 6],
}

/// What is true of a recording.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Truth {
    /// [`TRUTH_FORMAT`].
    pub format: String,
    /// Family.
    pub family: Family,
    /// Index.
    pub index: u32,
    /// Seed.
    pub seed: u64,
    /// Name of the camera.
    pub setup: String,
    /// How the data are not as declared.
    pub trap: Option<Trap>,
    /// What is hidden.
    pub effects: Vec<TrueEffect>,
    /// Cosine between two that are hidden.
    pub pair_cos: Option<f64>,
    /// The camera.
    pub camera: TrueCamera,
    /// Frames.
    pub frames: usize,
    /// Star images.
    pub stars: usize,
}

impl Truth {
    pub(super) fn new(
        family: Family,
        index: u32,
        seed: u64,
        world: &World,
        hidden: &[Hidden],
        trap: Option<Trap>,
        times_told: bool,
    ) -> Self {
        let fisher = Fisher::new(world);
        let offers = if hidden.is_empty() { Vec::new() } else { offers(world, times_told) };
        let effect = |one: &Hidden| {
            let signal = fisher.signal(one);
            let left = fisher.left(one);
            let mut alike: Vec<Alike> = offers
                .iter()
                .filter(|(id, _)| *id != one.kind.id() && signal.survival > 1e-3)
                .map(|(id, span)| Alike { id: (*id).to_owned(), cos: fisher.cosine(&left, span) })
                .filter(|alike| alike.cos >= ALIKE_FROM)
                .collect();
            alike.sort_by(|a, b| b.cos.total_cmp(&a.cos));
            TrueEffect {
                id: one.kind.id().to_owned(),
                label: one.kind.label().to_owned(),
                in_library: !one.kind.is_off_library(),
                parameters: one.parameters(),
                snr: signal.snr,
                multiple: signal.snr / JUST_SEEN,
                raw_rms_px: signal.raw_rms_px,
                survival: signal.survival,
                covariates: one.kind.covariates().iter().map(|name| (*name).to_owned()).collect(),
                alike,
                reckoned: None,
            }
        };
        let pair_cos = match hidden {
            [a, b] => Some(fisher.cosine(&fisher.left(a), std::slice::from_ref(b))),
            _ => None,
        };
        let optics = &world.optics;
        let [x0, y0] = optics.centre_px;
        Self {
            format: TRUTH_FORMAT.to_owned(),
            family,
            index,
            seed,
            setup: world.setup.to_owned(),
            trap,
            effects: hidden.iter().map(effect).collect(),
            pair_cos,
            camera: TrueCamera { parameters: [x0, y0, optics.focal_px, optics.k1, optics.p1, optics.p2] },
            frames: world.frames.len(),
            stars: world.images.len(),
        }
    }
}
