//! The families of concealed recordings, and what is hidden in the one of a given index.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::images::kind::{IMAGE_GROUPS, IMAGE_KINDS, IMAGE_PAIRS};
use super::kind::{ABSORBED, Kind, LIBRARY, OFF_LIBRARY};

/// A family of recordings.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Family {
    /// Nothing is hidden.
    Null,
    /// Nothing is hidden, and the data are not as declared.
    HardNull,
    /// One effect at 0.5 to 8 times what can just be seen.
    Ladder,
    /// An effect of known size that the model leaves out.
    Natural,
    /// One effect beside which another looks alike.
    Confuser,
    /// Two effects at once.
    Two,
    /// What attitudes and camera take up.
    Absorbed,
    /// What no library holds.
    OffLibrary,
    /// Frames of pixels, nothing hidden.
    PixelNull,
    /// Frames of pixels, one effect at 1 to 8 times what can just be seen.
    PixelLadder,
    /// Frames of pixels, what attitudes and camera take up.
    PixelAbsorbed,
    /// Frames of pixels, what no library holds.
    PixelOffLibrary,
    /// Frames of pixels with an image and a detector of their own, nothing hidden.
    ImageNull,
    /// Such frames, nothing hidden, and image, sky or catalogue not as one expects.
    ImageHardNull,
    /// Such frames, one effect in the pixels at 1 to 8 times what can just be seen.
    ImageLadder,
    /// Such frames, two effects in the pixels.
    ImageTwo,
    /// Such frames, four effects in the pixels, of which the diagnosis gives the same parameters.
    ImageSeveral,
}

/// All families.
pub const FAMILIES: [Family; 17] = [
    Family::Null,
    Family::HardNull,
    Family::Ladder,
    Family::Natural,
    Family::Confuser,
    Family::Two,
    Family::Absorbed,
    Family::OffLibrary,
    Family::PixelNull,
    Family::PixelLadder,
    Family::PixelAbsorbed,
    Family::PixelOffLibrary,
    Family::ImageNull,
    Family::ImageHardNull,
    Family::ImageLadder,
    Family::ImageTwo,
    Family::ImageSeveral,
];

/// Multiples of the size that is just seen (5 standard errors) on the ladder.
pub const LADDER: [f64; 7] = [0.5, 0.7, 1.0, 1.4, 2.0, 4.0, 8.0];
/// The same for frames of pixels.
pub const PIXEL_LADDER: [f64; 4] = [1.0, 2.0, 4.0, 8.0];
/// Signal-to-noise ratios of what is in no library, for frames of pixels.
pub const PIXEL_STRENGTHS: [f64; 2] = [15.0, 30.0];
/// Signal-to-noise ratios of confusers and of what is in no library.
pub const STRENGTHS: [f64; 3] = [8.0, 15.0, 30.0];

/// In what way the data of a hard null are not as declared.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Trap {
    /// The telemetry of the frames is exchanged among them.
    TelemetryShuffled,
    /// 10 % of the stars have another's name.
    Misidentified10,
    /// 30 % have.
    Misidentified30,
    /// Errors follow Student's t with three degrees of freedom.
    HeavyTails,
    /// Declared errors are half the true ones.
    ErrorsHalved,
    /// Declared errors are twice the true ones.
    ErrorsDoubled,
    /// Declared errors of bright stars are far too small.
    BrightErrors,
    /// The principal point lies 5 px beside the declared one.
    CentreOff,
    /// The distortion is three times larger.
    DistortionTripled,
    /// Star images have wide wings.
    WingedImages,
    /// Star images are elongated, all alike.
    ElongatedImages,
    /// Star images are longer on one side, all alike.
    LopsidedImages,
    /// Magnitudes of a quarter of the catalogue are wrong by 0.1 to 0.3.
    CatalogueMagnitudes,
    /// Stars of a frame move together with their neighbours.
    Turbulence,
    /// Clouds take grey light, by frame and over the field.
    Clouds,
    /// There are four frames.
    FewFrames,
    /// A third of the star images have a companion within them.
    BlendedField,
}

/// All traps.
pub const TRAPS: [Trap; 9] = [
    Trap::TelemetryShuffled,
    Trap::Misidentified10,
    Trap::Misidentified30,
    Trap::HeavyTails,
    Trap::ErrorsHalved,
    Trap::ErrorsDoubled,
    Trap::BrightErrors,
    Trap::CentreOff,
    Trap::DistortionTripled,
];

/// The traps of frames of pixels.
pub const IMAGE_TRAPS: [Trap; 8] = [
    Trap::WingedImages,
    Trap::ElongatedImages,
    Trap::LopsidedImages,
    Trap::CatalogueMagnitudes,
    Trap::Turbulence,
    Trap::Clouds,
    Trap::FewFrames,
    Trap::BlendedField,
];

/// Pairs that look alike, the first hidden: whether the camera turns at one rate in all frames, too.
const CONFUSERS: [(Kind, Kind, bool); 22] = [
    (Kind::ThermalFocalLength, Kind::ThermalDistortion, false),
    (Kind::ThermalDistortion, Kind::ThermalFocalLength, false),
    (Kind::PixelAspect, Kind::SensorStep, false),
    (Kind::SensorStep, Kind::PixelAspect, false),
    (Kind::Shear, Kind::SensorStep, false),
    (Kind::SensorStep, Kind::Shear, false),
    (Kind::PixelAspect, Kind::ChargeTransfer, false),
    (Kind::ChargeTransfer, Kind::PixelAspect, false),
    (Kind::MagnitudeEquation, Kind::Overshoot, false),
    (Kind::Overshoot, Kind::MagnitudeEquation, false),
    (Kind::ChargeTransfer, Kind::MagnitudeEquation, false),
    (Kind::MagnitudeEquation, Kind::ChargeTransfer, false),
    (Kind::FocalLengthDrift, Kind::ThermalFocalLength, false),
    (Kind::AberrationOfUnknownVelocity, Kind::ThermalFocalLength, false),
    (Kind::Aberration, Kind::FocalLengthDrift, false),
    (Kind::ThermalFocalLength, Kind::Aberration, false),
    (Kind::Refraction, Kind::PixelAspect, false),
    (Kind::ChromaticRefraction, Kind::WedgeColour, false),
    (Kind::WedgeColour, Kind::ChromaticRefraction, false),
    (Kind::RollingShutter, Kind::Shear, true),
    (Kind::Shear, Kind::RollingShutter, true),
    (Kind::EdgeRollOff, Kind::PixelAspect, false),
];

/// What is hidden in a recording, before its size is known.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Plan {
    /// Effects and their signal-to-noise ratios; 0 stands for the size that the thing has by nature.
    pub(super) hidden: Vec<(Kind, f64)>,
    /// How the data are not as declared.
    pub(super) trap: Option<Trap>,
    /// An effect that must be tellable: its telemetry is written too.
    pub(super) beside: Option<Kind>,
    /// One rate for all frames.
    pub(super) constant_rate: bool,
}

impl Family {
    /// Its number in the counters of random numbers: never to change.
    pub(super) fn number(self) -> u32 {
        self as u32 + 1
    }

    /// Its name in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Null => "null",
            Self::HardNull => "hard-null",
            Self::Ladder => "ladder",
            Self::Natural => "natural",
            Self::Confuser => "confuser",
            Self::Two => "two",
            Self::Absorbed => "absorbed",
            Self::OffLibrary => "off-library",
            Self::PixelNull => "pixel-null",
            Self::PixelLadder => "pixel-ladder",
            Self::PixelAbsorbed => "pixel-absorbed",
            Self::PixelOffLibrary => "pixel-off-library",
            Self::ImageNull => "image-null",
            Self::ImageHardNull => "image-hard-null",
            Self::ImageLadder => "image-ladder",
            Self::ImageTwo => "image-two",
            Self::ImageSeveral => "image-several",
        }
    }

    /// For frames of pixels: the family of star lists in which the same is hidden.
    #[must_use]
    pub fn of_lists(self) -> Option<Self> {
        match self {
            Self::PixelNull => Some(Self::Null),
            Self::PixelLadder => Some(Self::Ladder),
            Self::PixelAbsorbed => Some(Self::Absorbed),
            Self::PixelOffLibrary => Some(Self::OffLibrary),
            _ => None,
        }
    }

    /// Whether what is hidden is hidden in the pixels themselves.
    #[must_use]
    pub fn is_of_images(self) -> bool {
        matches!(self, Self::ImageNull | Self::ImageHardNull | Self::ImageLadder | Self::ImageTwo | Self::ImageSeveral)
    }

    /// The family of a name.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        FAMILIES.into_iter().find(|family| family.name() == name)
    }

    /// After so many indices every case of the family has come once.
    #[must_use]
    pub fn cycle(self) -> u32 {
        let cycle = match self {
            Self::Null => 4,
            Self::HardNull => TRAPS.len(),
            Self::Ladder => LIBRARY.len() * LADDER.len(),
            Self::Natural => 3,
            Self::Confuser => CONFUSERS.len() * STRENGTHS.len(),
            Self::Two | Self::ImageNull => 1,
            Self::Absorbed | Self::PixelAbsorbed => ABSORBED.len(),
            Self::OffLibrary => OFF_LIBRARY.len() * STRENGTHS.len(),
            Self::PixelNull => 2,
            Self::PixelLadder => LIBRARY.len() * PIXEL_LADDER.len(),
            Self::PixelOffLibrary => OFF_LIBRARY.len() * PIXEL_STRENGTHS.len(),
            Self::ImageHardNull => IMAGE_TRAPS.len(),
            Self::ImageLadder => IMAGE_KINDS.len() * PIXEL_LADDER.len(),
            Self::ImageTwo => IMAGE_PAIRS.len() * 2,
            Self::ImageSeveral => IMAGE_GROUPS.len() * 2,
        };
        cycle as u32
    }

    /// What is hidden in the recording of an index. Pairs come from the caller's random numbers.
    pub(super) fn plan(self, index: u32, pair: impl FnOnce() -> [(Kind, f64); 2]) -> Plan {
        const JUST_SEEN: f64 = 5.0;
        let at = index as usize;
        let of = |hidden: Vec<(Kind, f64)>| Plan { hidden, trap: None, beside: None, constant_rate: false };
        match self {
            // What is hidden in pixels has a plan of its own.
            Self::ImageNull
            | Self::ImageHardNull
            | Self::ImageLadder
            | Self::ImageTwo
            | Self::ImageSeveral
            | Self::Null
            | Self::PixelNull => of(Vec::new()),
            Self::HardNull => Plan { trap: Some(TRAPS[at % TRAPS.len()]), ..of(Vec::new()) },
            Self::Ladder => of(vec![(LIBRARY[at % LIBRARY.len()], JUST_SEEN * LADDER[at / LIBRARY.len() % LADDER.len()])]),
            Self::Natural => of(vec![([Kind::ProperMotionLeftOut, Kind::Aberration, Kind::Refraction][at % 3], 0.0)]),
            Self::Confuser => {
                let (truth, rival, constant_rate) = CONFUSERS[at % CONFUSERS.len()];
                let strength = STRENGTHS[at / CONFUSERS.len() % STRENGTHS.len()];
                Plan { beside: Some(rival), constant_rate, ..of(vec![(truth, strength)]) }
            }
            Self::Two => of(pair().to_vec()),
            Self::PixelLadder => of(vec![(LIBRARY[at % LIBRARY.len()], JUST_SEEN * PIXEL_LADDER[at / LIBRARY.len() % PIXEL_LADDER.len()])]),
            Self::Absorbed | Self::PixelAbsorbed => of(vec![(ABSORBED[at % ABSORBED.len()], 0.0)]),
            Self::OffLibrary => of(vec![(OFF_LIBRARY[at % OFF_LIBRARY.len()], STRENGTHS[at / OFF_LIBRARY.len() % STRENGTHS.len()])]),
            Self::PixelOffLibrary => {
                let strength = PIXEL_STRENGTHS[at / OFF_LIBRARY.len() % PIXEL_STRENGTHS.len()];
                of(vec![(OFF_LIBRARY[at % OFF_LIBRARY.len()], strength)])
            }
        }
    }
}
