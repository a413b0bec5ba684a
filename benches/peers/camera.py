"""The camera of the calibrator, and the joint least squares of one camera and one attitude a frame (`scipy`).

Conventions are those of CONVENTIONS.md: pixel (0, 0) is the centre of the first pixel, the distortion is taken away at the
measured point, direction ∝ (x̄ − Δx, ȳ − Δy, f).
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares
from scipy.sparse import csr_matrix
from scipy.spatial.transform import Rotation

NAMES = ("x0", "y0", "f", "k1", "p1", "p2")


@dataclass(frozen=True)
class Camera:
    """Principal point and focal length in pixels, k1 in px⁻², p1 and p2 in px⁻¹."""

    width_px: int
    height_px: int
    x0_px: float
    y0_px: float
    focal_length_px: float
    k1: float = 0.0
    p1: float = 0.0
    p2: float = 0.0

    @property
    def middle_px(self) -> np.ndarray:
        return np.array([(self.width_px - 1) / 2.0, (self.height_px - 1) / 2.0])

    @property
    def parameters(self) -> np.ndarray:
        return np.array([self.x0_px, self.y0_px, self.focal_length_px, self.k1, self.p1, self.p2])

    def with_parameters(self, values) -> "Camera":
        x0, y0, f, k1, p1, p2 = values
        return replace(self, x0_px=x0, y0_px=y0, focal_length_px=f, k1=k1, p1=p1, p2=p2)

    def corrected(self, bar: np.ndarray) -> np.ndarray:
        """Points relative to the principal point without their distortion."""
        x, y = bar.T
        square = x * x + y * y
        dx = self.k1 * x * square + self.p1 * (3 * x * x + y * y) + 2 * self.p2 * x * y
        dy = self.k1 * y * square + self.p2 * (3 * y * y + x * x) + 2 * self.p1 * x * y
        return np.column_stack([x - dx, y - dy])

    def correction_jacobian(self, bar: np.ndarray) -> np.ndarray:
        """∂ corrected / ∂ bar, one 2 × 2 matrix a point."""
        x, y = bar.T
        square = x * x + y * y
        across = 2 * self.k1 * x * y + 2 * self.p1 * y + 2 * self.p2 * x
        xx = 1 - self.k1 * (square + 2 * x * x) - 6 * self.p1 * x - 2 * self.p2 * y
        yy = 1 - self.k1 * (square + 2 * y * y) - 6 * self.p2 * y - 2 * self.p1 * x
        return np.stack([np.stack([xx, -across], axis=-1), np.stack([-across, yy], axis=-1)], axis=-2)

    def distorted(self, ideal: np.ndarray) -> np.ndarray:
        """The inverse of `corrected`, by Newton's method."""
        bar = ideal.copy()
        for _ in range(8):
            missing = self.corrected(bar) - ideal
            (xx, xy), (_, yy) = self.correction_jacobian(bar).transpose(1, 2, 0)
            determinant = xx * yy - xy * xy
            step = np.column_stack([yy * missing[:, 0] - xy * missing[:, 1], xx * missing[:, 1] - xy * missing[:, 0]])
            bar -= step / determinant[:, None]
            if np.abs(missing).max() < 1e-6:  # the step taken beyond it squares what is left
                break
        return bar

    def project(self, vector: np.ndarray) -> np.ndarray:
        """Pixels of directions in camera axes."""
        ideal = self.focal_length_px * vector[:, :2] / vector[:, 2:]
        return self.distorted(ideal) + [self.x0_px, self.y0_px]

    def rays(self, pixel: np.ndarray) -> np.ndarray:
        """Unit vectors in camera axes of pixels."""
        plane = self.corrected(pixel - [self.x0_px, self.y0_px])
        return unit(np.column_stack([plane, np.full(len(plane), self.focal_length_px)]))


def unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector, axis=1, keepdims=True)


def best_rotation(from_vectors: np.ndarray, to_vectors: np.ndarray) -> np.ndarray:
    """The rotation that takes the first unit vectors to the second with the least sum of squares."""
    u, _, v = np.linalg.svd(to_vectors.T @ from_vectors)
    return u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ v))]) @ v


def map_error_px(rays, truth: Camera, points: int = 13) -> tuple[float, float]:
    """Rms and largest difference between a pixel → direction map and the true one over a grid of pixels that reaches from edge
    to edge, after the best rotation, in pixels (angle times true focal length)."""
    x = np.linspace(-0.5, truth.width_px - 0.5, points)
    y = np.linspace(-0.5, truth.height_px - 0.5, points)
    grid = np.array(np.meshgrid(x, y)).reshape(2, -1).T
    theirs, ours = rays(grid), truth.rays(grid)
    error = np.linalg.norm(theirs @ best_rotation(theirs, ours).T - ours, axis=1) * truth.focal_length_px
    return float(np.sqrt(np.mean(error**2))), float(error.max())


@dataclass(frozen=True)
class Frame:
    """Star images of one exposure: catalogue numbers, ICRS unit vectors, measured pixels, standard errors (px, per axis)."""

    hip: np.ndarray
    direction: np.ndarray
    pixel: np.ndarray
    sigma_px: np.ndarray
    magnitude: np.ndarray


@dataclass(frozen=True)
class JointFit:
    """What the joint least squares found."""

    camera: Camera
    attitudes: list
    sigma: np.ndarray  # standard errors of the free parameters, in their order
    chi2_per_dof: float
    residuals_px: np.ndarray  # all frames in order, measured − model
    evaluations: int


class Problem:
    """Residuals in units of their standard errors and their analytic Jacobian, dense or sparse."""

    def __init__(self, frames: list, start: Camera, attitudes: list, free=("x0", "y0", "f", "k1")):
        self.start, self.attitudes, self.free = start, attitudes, [NAMES.index(name) for name in free]
        # Internal steps of the parameters, so that all columns are of like size.
        half = np.hypot(start.width_px, start.height_px) / 2.0
        self.step = np.array([1.0, 1.0, 1.0, half**-3, half**-2, half**-2])
        self.direction = np.concatenate([frame.direction for frame in frames])
        self.pixel = np.concatenate([frame.pixel for frame in frames])
        self.sigma = np.concatenate([frame.sigma_px for frame in frames])
        self.frame = np.repeat(np.arange(len(frames)), [len(frame.pixel) for frame in frames])
        self.count = len(self.free) + 3 * len(frames)
        camera, turn = len(self.free), len(self.free) + 3 * self.frame[:, None] + np.arange(3)
        columns = np.hstack([np.tile(np.arange(camera), (len(turn), 1)), turn])
        self.columns = np.repeat(columns, 2, axis=0).ravel()
        self.pointers = np.arange(0, self.columns.size + 1, camera + 3)

    def at(self, values: np.ndarray):
        """Camera and attitudes (rotation matrices) of a vector of internal parameters."""
        parameters = self.start.parameters
        parameters[self.free] += values[: len(self.free)] * self.step[self.free]
        turns = Rotation.from_rotvec(values[len(self.free) :].reshape(-1, 3)).as_matrix()
        return self.start.with_parameters(parameters), [turn @ attitude for turn, attitude in zip(turns, self.attitudes)]

    def residuals(self, values: np.ndarray) -> np.ndarray:
        camera, attitudes = self.at(values)
        seen = np.einsum("nij,nj->ni", np.array(attitudes)[self.frame], self.direction)
        return ((camera.project(seen) - self.pixel) / self.sigma[:, None]).ravel()

    def blocks(self, values: np.ndarray) -> np.ndarray:
        """Per star image, 2 × (free camera parameters + 3 of its frame's attitude)."""
        camera, attitudes = self.at(values)
        seen = np.einsum("nij,nj->ni", np.array(attitudes)[self.frame], self.direction)
        tangent = seen[:, :2] / seen[:, 2:]
        bar = camera.distorted(camera.focal_length_px * tangent)
        (xx, xy), (_, yy) = camera.correction_jacobian(bar).transpose(1, 2, 0)
        inverse = np.array([[yy, -xy], [-xy, xx]]).transpose(2, 0, 1) / (xx * yy - xy * xy)[:, None, None]
        x, y = bar.T
        square, zero, one = x * x + y * y, np.zeros(len(x)), np.ones(len(x))
        # What the ideal point and the correction change by, one column a parameter.
        moves = {
            2: np.column_stack([tangent[:, 0], tangent[:, 1]]),
            3: np.column_stack([x * square, y * square]),
            4: np.column_stack([3 * x * x + y * y, 2 * x * y]),
            5: np.column_stack([2 * x * y, 3 * y * y + x * x]),
        }
        columns = []
        for k in self.free:
            column = np.column_stack([one, zero] if k == 0 else [zero, one]) if k < 2 else np.einsum("nij,nj->ni", inverse, moves[k])
            columns.append(column * self.step[k])
        camera_part = np.stack(columns, axis=-1)
        f, z = camera.focal_length_px, seen[:, 2]
        by_vector = np.zeros((len(x), 2, 3))
        by_vector[:, 0, 0] = by_vector[:, 1, 1] = f / z
        by_vector[:, :, 2] = -f * tangent / z[:, None]
        # A small turn ω after the present attitude moves a direction by ω × seen; the chart takes a step of the rotation vector
        # to that ω.
        cross = np.zeros((len(x), 3, 3))
        cross[:, 0, 1], cross[:, 0, 2], cross[:, 1, 2] = seen[:, 2], -seen[:, 1], seen[:, 0]
        cross -= cross.transpose(0, 2, 1)
        chart = left_jacobians(values[len(self.free) :].reshape(-1, 3))[self.frame]
        turn_part = inverse @ by_vector @ cross @ chart
        return np.concatenate([camera_part, turn_part], axis=-1) / self.sigma[:, None, None]

    def sparse(self, values: np.ndarray) -> csr_matrix:
        return csr_matrix((self.blocks(values).ravel(), self.columns, self.pointers), shape=(2 * len(self.pixel), self.count))

    def dense(self, values: np.ndarray) -> np.ndarray:
        return self.sparse(values).toarray()

    def solve(self, sparse: bool = False) -> JointFit:
        """Least squares from the start."""
        start = np.zeros(self.count)
        if sparse:
            found = least_squares(self.residuals, start, self.sparse, method="trf", tr_solver="lsmr", x_scale="jac", xtol=1e-12)
        else:
            found = least_squares(self.residuals, start, self.dense, method="lm", x_scale="jac", xtol=1e-12, ftol=1e-12)
        camera, attitudes = self.at(found.x)
        jacobian = self.dense(found.x)
        covariance = np.linalg.inv(jacobian.T @ jacobian)[: len(self.free), : len(self.free)]
        sigma = np.sqrt(np.diag(covariance)) * self.step[self.free]
        dof = max(len(found.fun) - self.count, 1)
        residuals = -found.fun.reshape(-1, 2) * self.sigma[:, None]
        return JointFit(camera, attitudes, sigma, float(found.fun @ found.fun) / dof, residuals, found.nfev)


def left_jacobians(turns: np.ndarray) -> np.ndarray:
    """∂ (turn after a small step of the rotation vector) / ∂ step, at each rotation vector; series, for turns below a radian."""
    cross = np.zeros((len(turns), 3, 3))
    cross[:, 2, 1], cross[:, 0, 2], cross[:, 1, 0] = turns.T
    cross -= cross.transpose(0, 2, 1)
    return np.eye(3) + cross / 2.0 + cross @ cross / 6.0 + cross @ cross @ cross / 24.0


def joint_fit(frames: list, start: Camera, attitudes: list, free=("x0", "y0", "f", "k1"), sparse: bool = False) -> JointFit:
    """The joint least squares of camera and attitudes."""
    return Problem(frames, start, attitudes, free).solve(sparse)


def starting_attitudes(frames: list, camera: Camera) -> list:
    """The attitude of each frame that agrees best with a camera that is only about right."""
    return [best_rotation(frame.direction, camera.rays(frame.pixel)) for frame in frames]


def angles_px(rays, frame: Frame, focal_length_px: float) -> np.ndarray:
    """Residuals of a frame's stars for any pixel → direction map, with the attitude that makes their sum of squares least: the
    angle between measured and true direction, times a focal length."""
    measured = rays(frame.pixel)
    turned = frame.direction @ best_rotation(frame.direction, measured).T
    return np.linalg.norm(measured - turned, axis=1) * focal_length_px
