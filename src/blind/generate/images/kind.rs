//! What can be hidden in pixels: names, and how the size of each is reckoned.

use serde::{Deserialize, Serialize};

/// An effect that is hidden in pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[allow(missing_docs, reason = "each is described by its id, and by its equation where it is painted")]
pub enum PixelKind {
    Vignetting,
    Nonlinearity,
    BrighterFatter,
    ChargeTransfer,
    Passband,
    Extinction,
    FieldTilt,
    FieldCurvature,
    AxialColour,
    FocusWithTemperature,
    FocusWithTime,
    Coma,
    AmplifierStep,
    Prnu,
    HotPixels,
    RandomTelegraph,
    RowBanding,
    ColumnBanding,
    CodeWidths,
    LostBits,
    Compression,
    WrongGain,
    WrongReadNoise,
    DarkCurrent,
    AmplifierGlow,
    CosmicRays,
    MotionSmear,
    Jitter,
    IntrapixelResponse,
    FrameDimmer,
    ExposureTime,
    FieldStop,
    EvenOdd,
    Bayer,
    Crosstalk,
    Overshoot,
    StrayLight,
    VeilingGlare,
    Streaks,
}

use PixelKind::{
    AmplifierGlow, AmplifierStep, AxialColour, Bayer, BrighterFatter, ChargeTransfer, CodeWidths, ColumnBanding, Coma, Compression,
    CosmicRays, Crosstalk, DarkCurrent, EvenOdd, ExposureTime, Extinction, FieldCurvature, FieldStop, FieldTilt, FocusWithTemperature,
    FocusWithTime, FrameDimmer, HotPixels, IntrapixelResponse, Jitter, LostBits, MotionSmear, Nonlinearity, Overshoot, Passband, Prnu,
    RandomTelegraph, RowBanding, StrayLight, Streaks, VeilingGlare, Vignetting, WrongGain, WrongReadNoise,
};

/// All of them, each once.
pub const IMAGE_KINDS: [PixelKind; 39] = [
    Vignetting,
    Nonlinearity,
    BrighterFatter,
    ChargeTransfer,
    Passband,
    Extinction,
    FieldTilt,
    FieldCurvature,
    AxialColour,
    FocusWithTemperature,
    FocusWithTime,
    Coma,
    AmplifierStep,
    Prnu,
    HotPixels,
    RandomTelegraph,
    RowBanding,
    ColumnBanding,
    CodeWidths,
    LostBits,
    Compression,
    WrongGain,
    WrongReadNoise,
    DarkCurrent,
    AmplifierGlow,
    CosmicRays,
    MotionSmear,
    Jitter,
    IntrapixelResponse,
    FrameDimmer,
    ExposureTime,
    FieldStop,
    EvenOdd,
    Bayer,
    Crosstalk,
    Overshoot,
    StrayLight,
    VeilingGlare,
    Streaks,
];

/// Pairs that are hidden together: across channels, or with traces that run together.
pub const IMAGE_PAIRS: [[PixelKind; 2]; 14] = [
    [BrighterFatter, Nonlinearity],
    [Vignetting, Extinction],
    [FocusWithTemperature, AxialColour],
    [RowBanding, Vignetting],
    [ChargeTransfer, Vignetting],
    [FieldCurvature, FocusWithTime],
    [Prnu, HotPixels],
    [WrongGain, RowBanding],
    [Passband, Extinction],
    [AmplifierStep, Vignetting],
    [Coma, FieldTilt],
    [CodeWidths, CosmicRays],
    [Nonlinearity, Passband],
    [DarkCurrent, Prnu],
];

/// Four that are hidden together, each of which the diagnosis sizes by the parameter that is hidden: sizes and errors of several at once. No two of a
/// group are known to be told apart badly, as a wrong gain is beside noise that a row shares.
pub const IMAGE_GROUPS: [[PixelKind; 4]; 7] = [
    [AmplifierStep, RowBanding, Passband, Prnu],
    [EvenOdd, ColumnBanding, Extinction, Crosstalk],
    [WrongGain, Passband, Extinction, EvenOdd],
    [Prnu, ColumnBanding, AmplifierStep, Extinction],
    [ExposureTime, RowBanding, EvenOdd, Passband],
    [DarkCurrent, AmplifierStep, Passband, Crosstalk],
    [Nonlinearity, ColumnBanding, Prnu, ExposureTime],
];

/// How the size of what is hidden is reckoned.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Reckoned {
    /// Fisher information of the noiseless stamps: brightness, width and what else of the image; place, background and width of each star, zero
    /// point of each frame and mean width are free.
    Stamps,
    /// The same with one zero point for all frames.
    StampsOfFrames,
    /// Fisher information of the pixels between the stars under a level and slopes of each frame's own.
    Background,
    /// Analytic Fisher information of a variance, a mean or a histogram of the pixels.
    Noise,
    /// Not by information: steps of physical units, that stand in the truth's parameters.
    Steps,
}

impl PixelKind {
    /// The id of the effect in result files.
    #[must_use]
    pub fn id(self) -> &'static str {
        match self {
            Vignetting => "vignetting",
            Nonlinearity => "nonlinearity",
            BrighterFatter => "brighter-fatter",
            ChargeTransfer => "charge-transfer-inefficiency",
            Passband => "passband",
            Extinction => "extinction",
            FieldTilt | FieldCurvature => "psf-shape",
            AxialColour => "axial-colour",
            FocusWithTemperature | FocusWithTime => "focus-drift",
            Coma => "coma",
            AmplifierStep => "amplifier-step",
            Prnu => "prnu",
            HotPixels => "hot-pixels",
            RandomTelegraph => "random-telegraph",
            RowBanding | ColumnBanding => "banding",
            CodeWidths | LostBits => "adc",
            Compression => "compression",
            WrongGain | WrongReadNoise => "gain-noise",
            DarkCurrent => "dark-current",
            AmplifierGlow => "amplifier-glow",
            CosmicRays => "cosmic-rays",
            MotionSmear => "motion-smear",
            Jitter => "jitter",
            IntrapixelResponse => "intrapixel-response",
            FrameDimmer => "zero-point",
            ExposureTime => "exposure-time",
            FieldStop => "field-stop",
            EvenOdd => "even-odd",
            Bayer => "bayer",
            Crosstalk => "crosstalk",
            Overshoot => "overshoot",
            StrayLight => "stray-light",
            VeilingGlare => "veiling-glare",
            Streaks => "streaks",
        }
    }

    /// The name in tables, where an id stands for more than one case.
    #[must_use]
    pub fn label(self) -> &'static str {
        match self {
            FieldTilt => "psf-shape, tilt",
            FieldCurvature => "psf-shape, curvature",
            FocusWithTemperature => "focus-drift, temperature",
            FocusWithTime => "focus-drift, time",
            RowBanding => "banding, rows",
            ColumnBanding => "banding, columns",
            CodeWidths => "adc, code widths",
            LostBits => "adc, lost bits",
            WrongGain => "gain-noise, gain",
            WrongReadNoise => "gain-noise, read noise",
            FrameDimmer => "zero-point, one frame",
            other => other.id(),
        }
    }

    /// The effect of a label.
    #[must_use]
    pub fn labelled(label: &str) -> Option<Self> {
        IMAGE_KINDS.into_iter().find(|kind| kind.label() == label)
    }

    /// Ids that are a right answer: the same trace under another usual name.
    #[must_use]
    pub fn also(self) -> &'static [&'static str] {
        match self {
            FrameDimmer => &["clouds", "exposure-time"],
            ExposureTime => &["zero-point", "clouds"],
            EvenOdd => &["bayer"],
            _ => &[],
        }
    }

    /// How its size is reckoned.
    #[must_use]
    pub fn reckoned(self) -> Reckoned {
        match self {
            FrameDimmer | ExposureTime => Reckoned::StampsOfFrames,
            AmplifierGlow | StrayLight | VeilingGlare | Crosstalk => Reckoned::Background,
            Prnu | RowBanding | ColumnBanding | CodeWidths | WrongGain | WrongReadNoise | DarkCurrent | EvenOdd | Bayer | Overshoot => {
                Reckoned::Noise
            }
            HotPixels | RandomTelegraph | LostBits | Compression | CosmicRays | FieldStop | Streaks => Reckoned::Steps,
            _ => Reckoned::Stamps,
        }
    }

    /// The covariates that are a right answer to "where?".
    #[must_use]
    pub fn covariates(self) -> &'static [&'static str] {
        match self {
            Vignetting | FieldCurvature | FieldStop => &["field-radius", "field-map"],
            FieldTilt | Coma => &["field-map", "field-radius", "field-azimuth", "x", "y"],
            Nonlinearity | BrighterFatter | Overshoot => &["flux", "magnitude"],
            ChargeTransfer => &["row", "flux", "magnitude"],
            Passband | AxialColour => &["colour"],
            Extinction => &["zenith"],
            FocusWithTemperature => &["temperature"],
            FocusWithTime => &["time"],
            AmplifierStep | RowBanding => &["row", "y"],
            ColumnBanding => &["row", "x"],
            MotionSmear => &["rate", "frame"],
            Jitter | FrameDimmer | ExposureTime | CosmicRays | Streaks => &["frame"],
            IntrapixelResponse => &["pixel-phase-x", "pixel-phase-y"],
            EvenOdd | Bayer => &["pixel-parity-x", "pixel-parity-y"],
            Prnu | DarkCurrent => &["fixed-pattern", "exposure"],
            WrongGain | WrongReadNoise => &["level"],
            Crosstalk | StrayLight | VeilingGlare | AmplifierGlow => &["background-gradient", "x", "y", "field-map"],
            HotPixels | RandomTelegraph => &["pixel"],
            CodeWidths | LostBits => &["code"],
            Compression => &["block"],
        }
    }

    /// Whether its size may have either sign.
    pub(super) fn has_sign(self) -> bool {
        matches!(
            self,
            Passband
                | FieldTilt
                | FieldCurvature
                | AxialColour
                | FocusWithTemperature
                | FocusWithTime
                | AmplifierStep
                | WrongGain
                | ExposureTime
                | EvenOdd
                | Bayer
        )
    }

    /// The largest size that is hidden: more would be seen by eye, or is no camera's.
    pub(super) fn largest(self) -> f64 {
        match self {
            Vignetting => 0.8,
            Nonlinearity => 0.2,
            BrighterFatter => 0.3,
            ChargeTransfer | FocusWithTemperature => 0.5,
            Passband | Extinction | IntrapixelResponse => 0.9,
            FrameDimmer => 1.5,
            ExposureTime => 0.6,
            AmplifierStep | FocusWithTime => 0.4,
            FieldTilt | FieldCurvature | AxialColour | Coma => 3.0,
            // Half of the widths are below this, px.
            Jitter => 1.0,
            // Of the whole exposure.
            MotionSmear => 2.0,
            Crosstalk | Overshoot | VeilingGlare => 0.1,
            _ => f64::INFINITY,
        }
    }

    /// Whether air must be above the camera, or must not; `None`: either will do. Below air nothing tells jitter from seeing, haze and dew on the lens.
    pub(super) fn needs_ground(self) -> Option<bool> {
        match self {
            Extinction => Some(true),
            Jitter => Some(false),
            _ => None,
        }
    }

    /// Whether the exposures of the frames must differ.
    pub(super) fn needs_exposures(self) -> bool {
        matches!(self, DarkCurrent | AmplifierGlow)
    }

    /// Its size, smallest for what is reckoned by steps: a multiple is so many times this.
    pub(super) fn step(self, noise_dn: f64) -> f64 {
        match self {
            // Pixels.
            HotPixels | RandomTelegraph => 3.0,
            // Tracks in a frame.
            CosmicRays => 0.5,
            // Lines in a frame.
            Streaks => 0.1,
            // Quantiser of the cosine transform, DN: an eighth of the noise and up.
            Compression => 0.5 * noise_dn,
            // Half-diagonals that the stop reaches into the frame.
            FieldStop => 0.015,
            _ => 1.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_effect_is_listed_once_under_a_label_of_its_own() {
        for kind in IMAGE_KINDS {
            assert_eq!(PixelKind::labelled(kind.label()), Some(kind), "{kind:?}");
            assert_eq!(IMAGE_KINDS.iter().filter(|other| **other == kind).count(), 1);
            assert!(!kind.covariates().is_empty());
        }
    }
}
