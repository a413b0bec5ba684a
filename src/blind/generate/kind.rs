//! What can be hidden: names, groups, and what a diagnosis should find it by.

/// What a hidden displacement is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[allow(missing_docs, reason = "each is described by its id, and by its equation where it is computed")]
pub enum Kind {
    Aberration,
    AberrationOfUnknownVelocity,
    EpochOffset,
    ProperMotionLeftOut,
    Refraction,
    ChromaticRefraction,
    ThermalFocalLength,
    FocalLengthDrift,
    ThermalDistortion,
    RadialFifth,
    RadialSeventh,
    PixelAspect,
    Shear,
    QuadraticRest,
    LateralColour,
    WedgeColour,
    RollingShutter,
    SensorStep,
    Spiral,
    EdgeRollOff,
    Coma,
    ChargeTransfer,
    SCurve,
    EvenOdd,
    MagnitudeEquation,
    Overshoot,
    // Taken up by attitudes and camera.
    ThinPrism,
    DetectorTilt,
    BoresightDrift,
    TimeTag,
    // In no library.
    DistortionOfOneFrame,
    QuadrantStep,
    HalfTimeScale,
    ColourWave,
    TreeRings,
    BumpMap,
    RadialSquare,
    ShearOfFrames,
    MagnitudeWave,
    UntoldScale,
    HalfRotation,
    RowWave,
    ColourTrefoil,
    FocusStepTrefoil,
}

/// What is hidden: a displacement of this size, in the direction that the numbers say.
#[derive(Clone, Debug, PartialEq)]
pub struct Hidden {
    /// What it is.
    pub kind: Kind,
    /// Its size: displacements are proportional to it.
    pub size: f64,
    /// Its shape, each kind's own.
    pub numbers: Vec<f64>,
}

/// A parameter as the result files name it.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct TrueParameter {
    /// Name without the effect's.
    pub name: String,
    /// Value.
    pub value: f64,
    /// Unit.
    pub unit: String,
}

use Kind::{
    Aberration, AberrationOfUnknownVelocity, BoresightDrift, BumpMap, ChargeTransfer, ChromaticRefraction, ColourTrefoil, ColourWave, Coma,
    DetectorTilt, DistortionOfOneFrame, EdgeRollOff, EpochOffset, EvenOdd, FocalLengthDrift, FocusStepTrefoil, HalfRotation, HalfTimeScale,
    LateralColour, MagnitudeEquation, MagnitudeWave, Overshoot, PixelAspect, ProperMotionLeftOut, QuadrantStep, QuadraticRest, RadialFifth,
    RadialSeventh, RadialSquare, Refraction, RollingShutter, RowWave, SCurve, SensorStep, Shear, ShearOfFrames, Spiral, ThermalDistortion,
    ThermalFocalLength, ThinPrism, TimeTag, TreeRings, UntoldScale, WedgeColour,
};

/// The effects of the library that can be seen, each once.
pub const LIBRARY: [Kind; 25] = [
    Aberration,
    AberrationOfUnknownVelocity,
    EpochOffset,
    Refraction,
    ChromaticRefraction,
    ThermalFocalLength,
    FocalLengthDrift,
    ThermalDistortion,
    RadialFifth,
    RadialSeventh,
    PixelAspect,
    Shear,
    QuadraticRest,
    LateralColour,
    WedgeColour,
    RollingShutter,
    SensorStep,
    Spiral,
    EdgeRollOff,
    Coma,
    ChargeTransfer,
    SCurve,
    EvenOdd,
    MagnitudeEquation,
    Overshoot,
];

/// What attitudes and camera take up.
pub const ABSORBED: [Kind; 4] = [ThinPrism, DetectorTilt, BoresightDrift, TimeTag];

/// What no library holds.
pub const OFF_LIBRARY: [Kind; 14] = [
    DistortionOfOneFrame,
    QuadrantStep,
    HalfTimeScale,
    ColourWave,
    TreeRings,
    BumpMap,
    RadialSquare,
    ShearOfFrames,
    MagnitudeWave,
    UntoldScale,
    HalfRotation,
    RowWave,
    ColourTrefoil,
    FocusStepTrefoil,
];

impl Kind {
    /// The id of the effect in result files; of what is in no library a name of its own.
    #[must_use]
    pub fn id(self) -> &'static str {
        match self {
            Aberration | AberrationOfUnknownVelocity => "stellar-aberration",
            EpochOffset | ProperMotionLeftOut => "proper-motion",
            Refraction => "refraction",
            ChromaticRefraction => "chromatic-refraction",
            ThermalFocalLength => "thermal-focal-length",
            FocalLengthDrift => "focal-length-drift",
            ThermalDistortion => "thermal-distortion",
            RadialFifth | RadialSeventh => "radial-high-order",
            PixelAspect => "pixel-aspect",
            Shear => "shear",
            QuadraticRest => "quadratic-rest",
            LateralColour => "lateral-colour",
            WedgeColour => "wedge-colour",
            RollingShutter => "rolling-shutter",
            SensorStep => "sensor-step",
            Spiral => "spiral",
            EdgeRollOff => "edge-roll-off",
            Coma => "coma",
            ChargeTransfer => "charge-transfer-inefficiency",
            SCurve => "s-curve",
            EvenOdd => "even-odd",
            MagnitudeEquation => "magnitude-equation",
            Overshoot => "overshoot",
            ThinPrism => "thin-prism",
            DetectorTilt => "detector-tilt",
            BoresightDrift => "boresight-drift",
            TimeTag => "time-tag",
            DistortionOfOneFrame => "distortion-of-one-frame",
            QuadrantStep => "quadrant-step",
            HalfTimeScale => "half-time-scale",
            ColourWave => "colour-wave",
            TreeRings => "tree-rings",
            BumpMap => "bump-map",
            RadialSquare => "radial-square",
            ShearOfFrames => "shear-of-frames",
            MagnitudeWave => "magnitude-wave",
            UntoldScale => "untold-scale",
            HalfRotation => "half-rotation",
            RowWave => "row-wave",
            ColourTrefoil => "colour-trefoil",
            FocusStepTrefoil => "focus-step-trefoil",
        }
    }

    /// The name in tables, where an id stands for more than one case.
    #[must_use]
    pub fn label(self) -> &'static str {
        match self {
            AberrationOfUnknownVelocity => "stellar-aberration, velocity unknown",
            EpochOffset => "proper-motion, wrong epoch",
            ProperMotionLeftOut => "proper-motion, left out",
            RadialFifth => "radial-high-order, k2",
            RadialSeventh => "radial-high-order, k3",
            other => other.id(),
        }
    }

    /// The covariates that are a right answer to "where?".
    #[must_use]
    pub fn covariates(self) -> &'static [&'static str] {
        const FIELD: &[&str] = &["field-map", "field-azimuth", "x", "y", "row"];
        match self {
            Aberration | AberrationOfUnknownVelocity => &["velocity"],
            EpochOffset | ProperMotionLeftOut => &["proper-motion", "star"],
            Refraction | ChromaticRefraction => &["zenith"],
            ThermalFocalLength | ThermalDistortion | BoresightDrift => &["temperature"],
            FocalLengthDrift | HalfTimeScale => &["time", "frame"],
            RadialFifth | RadialSeventh | RadialSquare => &["field-radius", "field-map"],
            Spiral => &["field-radius", "field-map", "field-azimuth"],
            PixelAspect | Shear | QuadraticRest | ThinPrism | DetectorTilt | BumpMap | HalfRotation | QuadrantStep => FIELD,
            TreeRings | RowWave => &["field-map", "x", "y", "row", "field-radius"],
            LateralColour | WedgeColour | ColourWave | ColourTrefoil => &["colour"],
            RollingShutter => &["rate"],
            SensorStep => &["x", "column-half", "field-map"],
            EdgeRollOff => &["edge-distance", "field-map"],
            Coma | ChargeTransfer | MagnitudeEquation | Overshoot | MagnitudeWave => &["magnitude", "flux"],
            SCurve => &["pixel-phase-x", "pixel-phase-y"],
            EvenOdd => &["pixel-parity-x"],
            DistortionOfOneFrame | ShearOfFrames | UntoldScale | TimeTag => &["frame"],
            FocusStepTrefoil => &["focus_position"],
        }
    }

    /// Whether it needs a camera on the ground.
    pub(super) fn needs_ground(self) -> bool {
        matches!(self, Refraction | ChromaticRefraction | TimeTag)
    }

    /// Whether it needs a camera in space: its own velocity is what is hidden.
    pub(super) fn needs_space(self) -> bool {
        matches!(self, Aberration | AberrationOfUnknownVelocity)
    }

    /// Whether frames without a temperature cannot show it.
    pub(super) fn needs_temperature(self) -> bool {
        matches!(self, ThermalFocalLength | ThermalDistortion | BoresightDrift)
    }

    /// Whether it is one of those that no library holds.
    #[must_use]
    pub fn is_off_library(self) -> bool {
        OFF_LIBRARY.contains(&self)
    }
}
