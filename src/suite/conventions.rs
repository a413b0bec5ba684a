//! How a system under test writes attitudes and pixels: direction of the rotation, order of the quaternion, axes of its camera, origin of its pixels.

use nalgebra::{Matrix3, Quaternion, Rotation3, UnitQuaternion};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::coordinates::Attitude;
use crate::statistics::order::sort_by;

/// Which way the rotation goes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum RotationWay {
    /// It takes components in ICRS axes to components in camera axes.
    #[default]
    CameraFromIcrs,
    /// It takes components in camera axes to components in ICRS axes: the conjugate.
    IcrsFromCamera,
}

/// In which order the four numbers of a quaternion stand.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum QuaternionOrder {
    /// i, j, k, w: the scalar last.
    #[default]
    Xyzw,
    /// w, i, j, k: the scalar first.
    Wxyz,
}

/// Camera axes as a signed permutation of ours (x right, y down, z out along the boresight): `axes[k]` is which of ours the k-th is, and its sign.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SignedAxes(pub [(usize, i8); 3]);

impl Default for SignedAxes {
    fn default() -> Self {
        Self([(0, 1), (1, 1), (2, 1)])
    }
}

/// Directions on the frame, with the axis of ours and its sign.
const WORDS: [(&str, (usize, i8)); 6] =
    [("right", (0, 1)), ("left", (0, -1)), ("down", (1, 1)), ("up", (1, -1)), ("out", (2, 1)), ("in", (2, -1))];

impl SignedAxes {
    /// All 48: 24 right-handed and 24 mirrored.
    #[must_use]
    pub fn all() -> Vec<Self> {
        let orders = [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];
        let signs = |bits: u8| [0, 1, 2].map(|axis| if bits >> axis & 1 == 0 { 1 } else { -1 });
        let of = |order: [usize; 3]| (0..8).map(move |bits| Self([0, 1, 2].map(|axis| (order[axis], signs(bits)[axis]))));
        orders.into_iter().flat_map(of).collect()
    }

    /// Reads "x right, y down, z out along the boresight": three axes in the order x, y, z; each in a word of the frame.
    pub fn parse(text: &str) -> Result<Self, String> {
        let fault = || {
            format!(
                "axes = {text:?} is none; write where each axis points, as in \"x right, y down, z out\" (right, left, down, up, out, in)"
            )
        };
        let parts: Vec<&str> = text.split(',').map(str::trim).collect();
        let [x, y, z] = parts.as_slice() else { return Err(fault()) };
        let axis = |part: &str, name: &str| -> Option<(usize, i8)> {
            let mut words = part.split_whitespace();
            let own = words.next().filter(|word| *word == name).and_then(|_| words.next())?;
            WORDS.iter().find(|(word, _)| *word == own).map(|(_, axis)| *axis)
        };
        let axes = [axis(x, "x"), axis(y, "y"), axis(z, "z")].map(|axis| axis.ok_or_else(fault));
        let [x, y, z] = axes;
        let axes = [x?, y?, z?];
        let mut seen = axes.map(|(axis, _)| axis);
        seen.sort_unstable();
        if seen == [0, 1, 2] { Ok(Self(axes)) } else { Err(fault()) }
    }

    /// In words.
    #[must_use]
    pub fn words(&self) -> String {
        let word = |own: (usize, i8)| WORDS.iter().find(|(_, axis)| *axis == own).map_or("", |(word, _)| word);
        let [x, y, z] = self.0.map(word);
        format!("x {x}, y {y}, z {z}")
    }

    /// The matrix that takes components in our camera axes to components in these.
    #[must_use]
    pub fn matrix(&self) -> Matrix3<f64> {
        let mut matrix = Matrix3::zeros();
        for (row, (axis, sign)) in self.0.into_iter().enumerate() {
            matrix[(row, axis)] = f64::from(sign);
        }
        matrix
    }

    /// Whether the axes are left-handed: no rotation leads to them.
    #[must_use]
    pub fn is_mirrored(&self) -> bool {
        self.matrix().determinant() < 0.0
    }
}

/// An attitude as it is written.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum WrittenAttitude {
    /// Four numbers in the order of the file.
    Quaternion([f64; 4]),
    /// A matrix, row by row.
    Matrix([[f64; 3]; 3]),
    /// Right ascension, declination, and the position angle of the frame's upward direction, degrees.
    RaDecRoll([f64; 3]),
}

/// Where the first pixel's centre lies.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PixelOrigin {
    /// At this coordinate, in both axes: 0, 0.5 or 1.
    At(f64),
    /// Pixels are counted from the middle of the frame.
    Middle,
}

/// All conventions of a system.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Conventions {
    /// Which way the rotation goes.
    pub rotation: RotationWay,
    /// The order of the quaternion.
    pub quaternion: QuaternionOrder,
    /// Camera axes.
    pub axes: SignedAxes,
    /// Origin of the pixels.
    pub pixel_origin: PixelOrigin,
}

impl Default for Conventions {
    fn default() -> Self {
        Self {
            rotation: RotationWay::default(),
            quaternion: QuaternionOrder::default(),
            axes: SignedAxes::default(),
            pixel_origin: PixelOrigin::At(0.0),
        }
    }
}

impl Conventions {
    /// All that can be told apart by attitudes: 2 × 2 × 48, those of the origin of pixels left out.
    #[must_use]
    pub fn of_attitudes() -> Vec<Self> {
        let mut all = Vec::new();
        for axes in SignedAxes::all() {
            for rotation in [RotationWay::CameraFromIcrs, RotationWay::IcrsFromCamera] {
                for quaternion in [QuaternionOrder::Xyzw, QuaternionOrder::Wxyz] {
                    all.push(Self { rotation, quaternion, axes, ..Self::default() });
                }
            }
        }
        all
    }

    /// The attitude in our conventions; `None` where what is written is no rotation, or one from mirrored axes that no quaternion holds.
    #[must_use]
    pub fn read(&self, written: &WrittenAttitude) -> Option<Attitude> {
        let theirs = match written {
            // They have one meaning: that of the catalogue and of the frame as stored.
            WrittenAttitude::RaDecRoll(radec_roll_deg) => {
                let [ra, dec, roll] = radec_roll_deg.map(f64::to_radians);
                return Some(Attitude::from_pointing(ra, dec, roll));
            }
            WrittenAttitude::Quaternion(numbers) => {
                if self.axes.is_mirrored() {
                    return None;
                }
                *rotation_of(*numbers, self.quaternion)?.to_rotation_matrix().matrix()
            }
            WrittenAttitude::Matrix(rows) => Matrix3::from_fn(|row, column| rows[row][column]),
        };
        let theirs = if self.rotation == RotationWay::IcrsFromCamera { theirs.transpose() } else { theirs };
        attitude_of(self.axes.matrix().transpose() * theirs)
    }

    /// The numbers that a system with these conventions writes for an attitude.
    #[must_use]
    pub fn write(&self, attitude: &Attitude) -> [f64; 4] {
        let ours = *attitude.camera_from_icrs.to_rotation_matrix().matrix();
        let theirs = self.axes.matrix() * ours;
        let theirs = if self.rotation == RotationWay::IcrsFromCamera { theirs.transpose() } else { theirs };
        let [i, j, k, w] = quaternion_of_any(&theirs);
        match self.quaternion {
            QuaternionOrder::Xyzw => [i, j, k, w],
            QuaternionOrder::Wxyz => [w, i, j, k],
        }
    }

    /// A point of the system's own pixels on ours.
    #[must_use]
    pub fn pixel(&self, [x, y]: [f64; 2], [width_px, height_px]: [usize; 2]) -> [f64; 2] {
        match self.pixel_origin {
            PixelOrigin::At(first) => [x - first, y - first],
            PixelOrigin::Middle => [x + (width_px as f64 - 1.0) / 2.0, y + (height_px as f64 - 1.0) / 2.0],
        }
    }

    /// In words, as a suite file has them.
    #[must_use]
    pub fn words(&self) -> String {
        let rotation = if self.rotation == RotationWay::CameraFromIcrs { "camera_from_icrs" } else { "icrs_from_camera" };
        let quaternion = if self.quaternion == QuaternionOrder::Xyzw { "xyzw" } else { "wxyz" };
        format!("rotation = \"{rotation}\", quaternion = \"{quaternion}\", axes = \"{}\"", self.axes.words())
    }
}

/// The unit quaternion of four numbers, if they are near one.
fn rotation_of(numbers: [f64; 4], order: QuaternionOrder) -> Option<UnitQuaternion<f64>> {
    let [i, j, k, w] = match order {
        QuaternionOrder::Xyzw => numbers,
        QuaternionOrder::Wxyz => [numbers[1], numbers[2], numbers[3], numbers[0]],
    };
    let quaternion = Quaternion::new(w, i, j, k);
    let norm = quaternion.norm();
    (norm.is_finite() && (norm - 1.0).abs() < MAX_OFF_UNIT).then(|| UnitQuaternion::from_quaternion(quaternion))
}

/// A quaternion whose length is off by more is no rotation.
pub(super) const MAX_OFF_UNIT: f64 = 1e-2;

/// The attitude of a rotation matrix; `None` for a mirrored one and for what is no rotation.
fn attitude_of(matrix: Matrix3<f64>) -> Option<Attitude> {
    let off = (matrix * matrix.transpose() - Matrix3::identity()).abs().max();
    if !off.is_finite() || off > 2.0 * MAX_OFF_UNIT || matrix.determinant() < 0.0 {
        return None;
    }
    Some(Attitude::new(UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix(&matrix))))
}

/// The quaternion (scalar last) of a matrix by the formula of Shepperd, J. Guidance and Control 1, 223 (1978), without a look whether the matrix is
/// mirrored: what programs write that do not look either.
fn quaternion_of_any(m: &Matrix3<f64>) -> [f64; 4] {
    let trace = m.trace();
    let candidates = [m[(0, 0)], m[(1, 1)], m[(2, 2)], trace];
    let largest = (0..4).fold(0, |best, next| if candidates[next] > candidates[best] { next } else { best });
    let mut q = match largest {
        3 => [m[(2, 1)] - m[(1, 2)], m[(0, 2)] - m[(2, 0)], m[(1, 0)] - m[(0, 1)], 1.0 + trace],
        0 => [1.0 + 2.0 * m[(0, 0)] - trace, m[(0, 1)] + m[(1, 0)], m[(0, 2)] + m[(2, 0)], m[(2, 1)] - m[(1, 2)]],
        1 => [m[(0, 1)] + m[(1, 0)], 1.0 + 2.0 * m[(1, 1)] - trace, m[(1, 2)] + m[(2, 1)], m[(0, 2)] - m[(2, 0)]],
        _ => [m[(0, 2)] + m[(2, 0)], m[(1, 2)] + m[(2, 1)], 1.0 + 2.0 * m[(2, 2)] - trace, m[(1, 0)] - m[(0, 1)]],
    };
    let norm = q.iter().map(|own| own * own).sum::<f64>().sqrt();
    for own in &mut q {
        *own /= norm;
    }
    q
}

/// The angle between two quaternions as rotations, rad; the sign of a quaternion has no meaning.
#[must_use]
pub(super) fn angle_between_rad(a: [f64; 4], b: [f64; 4]) -> f64 {
    let dot: f64 = a.iter().zip(&b).map(|(a, b)| a * b).sum();
    let minus = dot.signum();
    let chord: f64 = a.iter().zip(&b).map(|(a, b)| (a - minus * b).powi(2)).sum::<f64>().sqrt();
    4.0 * (0.5 * chord).min(1.0).asin()
}

/// A convention that answers agree with.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ConventionAgreement {
    /// The convention.
    pub conventions: Conventions,
    /// Answers that agree with the truth under it.
    pub agreeing: usize,
    /// Median angle of those, rad.
    pub median_rad: f64,
}

/// Which conventions the answers agree with: truths and written attitudes in pairs; within `tolerance_rad`; the best first. Mirrored axes are among them: the
/// quaternion is then compared with that which a program writes that takes a mirrored matrix for a rotation.
#[must_use]
pub fn agreements(pairs: &[(Attitude, WrittenAttitude)], tolerance_rad: f64) -> Vec<ConventionAgreement> {
    let of = |conventions: Conventions| {
        let angle = |(truth, written): &(Attitude, WrittenAttitude)| match written {
            WrittenAttitude::Quaternion(numbers) => {
                let norm = numbers.iter().map(|own| own * own).sum::<f64>().sqrt();
                angle_between_rad(numbers.map(|own| own / norm), conventions.write(truth))
            }
            other => match conventions.read(other) {
                Some(read) => read.camera_from_icrs.angle_to(&truth.camera_from_icrs),
                None => f64::INFINITY,
            },
        };
        let mut angles: Vec<f64> = pairs.iter().map(angle).filter(|angle| *angle <= tolerance_rad).collect();
        angles.sort_by(f64::total_cmp);
        ConventionAgreement {
            conventions,
            agreeing: angles.len(),
            median_rad: angles.get(angles.len() / 2).copied().unwrap_or(f64::INFINITY),
        }
    };
    let mut all: Vec<ConventionAgreement> = Conventions::of_attitudes().into_iter().map(of).filter(|one| one.agreeing > 0).collect();
    sort_by(&mut all, |a, b| b.agreeing.cmp(&a.agreeing).then(a.median_rad.total_cmp(&b.median_rad)));
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    fn attitudes() -> Vec<Attitude> {
        (0..30).map(|k| Attitude::from_pointing(0.37 * f64::from(k), (f64::from(k) * 0.61).sin(), 1.1 * f64::from(k))).collect()
    }

    #[test]
    fn every_convention_is_found_again_from_its_own_answers() {
        let truths = attitudes();
        let mut found = 0;
        for own in Conventions::of_attitudes() {
            let pairs: Vec<_> = truths.iter().map(|truth| (*truth, WrittenAttitude::Quaternion(own.write(truth)))).collect();
            let all = agreements(&pairs, 1e-6);
            let full: Vec<&ConventionAgreement> = all.iter().filter(|one| one.agreeing == pairs.len()).collect();
            assert!(full.iter().any(|one| one.conventions == own), "{}", own.words());
            // Others are none, but where two conventions are one and the same rule.
            found += full.len();
        }
        // The negative control: hardly any convention is mistaken for another.
        assert!(found < 2 * 192, "{found}");
    }

    #[test]
    fn answers_are_read_back_under_right_handed_axes_and_refused_under_mirrored_ones() {
        for own in Conventions::of_attitudes() {
            for truth in attitudes() {
                let read = own.read(&WrittenAttitude::Quaternion(own.write(&truth)));
                assert_eq!(read.is_some(), !own.axes.is_mirrored());
                if let Some(read) = read {
                    assert!(read.camera_from_icrs.angle_to(&truth.camera_from_icrs) < 1e-9);
                }
                // A mirrored matrix is read where the axes say so.
                let matrix = own.axes.matrix() * truth.camera_from_icrs.to_rotation_matrix().matrix();
                let matrix = if own.rotation == RotationWay::IcrsFromCamera { matrix.transpose() } else { matrix };
                let rows = [0, 1, 2].map(|row| [0, 1, 2].map(|column| matrix[(row, column)]));
                let read = own.read(&WrittenAttitude::Matrix(rows)).unwrap();
                assert!(read.camera_from_icrs.angle_to(&truth.camera_from_icrs) < 1e-7);
            }
        }
    }

    #[test]
    fn axes_are_read_in_words() {
        let axes = SignedAxes::all();
        assert_eq!((axes.len(), axes.iter().filter(|axes| axes.is_mirrored()).count()), (48, 24));
        for own in axes {
            assert_eq!(SignedAxes::parse(&own.words()), Ok(own));
        }
        for bad in ["x right, y down", "x right, y right, z out", "y down, x right, z out", "x sideways, y down, z out"] {
            assert!(SignedAxes::parse(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn numbers_that_are_no_rotation_are_none() {
        let read = |numbers| Conventions::default().read(&WrittenAttitude::Quaternion(numbers));
        assert!(read([0.0, 0.0, 0.0, 1.001]).is_some());
        assert!(read([0.0; 4]).is_none() && read([0.5, 0.5, 0.5, 0.9]).is_none() && read([f64::NAN, 0.0, 0.0, 1.0]).is_none());
    }
}
