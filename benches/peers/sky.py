"""The program's own star catalogue, read from its packed form, and random views of the sky.

The layout is described at the head of `src/catalog/binary.rs`. Directions are ICRS unit vectors at the catalogue's epoch.
"""

import hashlib
import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

ROOT = Path(__file__).resolve().parents[2]
PACKED = ROOT / "catalogs" / "hipparcos.bin"
HEAD = struct.Struct("<8shdiiih")
STAR_BYTES, MOTION_BYTES = 20, 9
MAS_RAD = np.pi / 180.0 / 3.6e6


@dataclass(frozen=True)
class Catalog:
    """Stars, brightest first: Hipparcos number, unit vector, V; proper motion (east times cos δ, north) in mas/yr, NaN unknown."""

    epoch_yr: float
    hip: np.ndarray
    direction: np.ndarray
    magnitude: np.ndarray
    proper_motion_mas_yr: np.ndarray

    def index(self) -> dict:
        """Row of each Hipparcos number."""
        return {int(hip): row for row, hip in enumerate(self.hip)}

    def radec_deg(self) -> np.ndarray:
        """Right ascension and declination in degrees."""
        x, y, z = self.direction.T
        return np.column_stack([np.degrees(np.arctan2(y, x)) % 360.0, np.degrees(np.arcsin(z))])

    def at(self, year: float) -> np.ndarray:
        """Unit vectors at a Julian year; stars whose motion is not known stay."""
        x, y, z = self.direction.T
        across = np.hypot(x, y)
        east = np.column_stack([-y / across, x / across, np.zeros_like(z)])
        north = np.column_stack([-z * x / across, -z * y / across, across])
        motion = np.nan_to_num(self.proper_motion_mas_yr) * MAS_RAD * (year - self.epoch_yr)
        moved = self.direction + east * motion[:, :1] + north * motion[:, 1:]
        return moved / np.linalg.norm(moved, axis=1, keepdims=True)


def signed(rows: np.ndarray, start: int, width: int) -> np.ndarray:
    """Little-endian signed integers of `width` bytes from the columns of a table of bytes."""
    value = sum(rows[:, start + k].astype(np.int64) << (8 * k) for k in range(width))
    return np.where(value >= 1 << (8 * width - 1), value - (1 << (8 * width)), value)


def read_catalog(path: Path = PACKED) -> Catalog:
    """Reads the packed catalogue and checks its sum."""
    data = path.read_bytes()
    if hashlib.sha256(data[:-32]).digest() != data[-32:]:
        raise ValueError(f"{path}: its checksum is wrong; take the file from the repository again")
    magic, version, epoch, stars, motions, _doubtful, source = HEAD.unpack_from(data)
    if magic != b"BSTARCAT" or version != 1:
        raise ValueError(f"{path}: not a packed catalogue of version 1 ({magic!r}, {version})")
    start = HEAD.size + source
    rows = np.frombuffer(data, np.uint8, stars * STAR_BYTES, start).reshape(stars, STAR_BYTES)
    ra, dec = np.radians(signed(rows, 3, 5) * 1e-8), np.radians(signed(rows, 8, 5) * 1e-8 - 90.0)
    direction = np.column_stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])
    moving = np.frombuffer(data, np.uint8, motions * MOTION_BYTES, start + rows.size).reshape(motions, MOTION_BYTES)
    motion = np.full((stars, 2), np.nan)
    motion[signed(moving, 0, 3)] = np.column_stack([signed(moving, 3, 3), signed(moving, 6, 3)]) / 100.0
    return Catalog(epoch, signed(rows, 0, 3), direction, signed(rows, 13, 2) / 100.0, motion)


def lone(catalog: Catalog, distance_rad: float) -> np.ndarray:
    """True for the stars with no other star of the catalogue within a distance."""
    distance, _ = cKDTree(catalog.direction).query(catalog.direction, k=2)
    return distance[:, 1] > distance_rad


def view(camera, catalog: Catalog, allowed: np.ndarray, attitude: np.ndarray):
    """Rows of the allowed stars that fall on the frame of a camera with the attitude `camera_from_icrs`, and their true pixels."""
    seen = catalog.direction @ attitude.T
    reach = np.cos(1.1 * np.arctan(np.hypot(camera.width_px, camera.height_px) / 2.0 / camera.focal_length_px))
    rows = np.flatnonzero(allowed & (seen[:, 2] > reach))
    pixel = camera.project(seen[rows])
    inside = (np.abs(pixel - camera.middle_px) < np.array([camera.width_px, camera.height_px]) / 2.0).all(axis=1)
    return rows[inside], pixel[inside]


def random_attitude(random: np.random.Generator) -> np.ndarray:
    """A rotation, all alike likely."""
    return Rotation.random(rng=random).as_matrix()
