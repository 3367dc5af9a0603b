"""Pinhole cameras: OpenCV axes, pixel centres at half-integers."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

# What is added to local coordinates to get those of a scene's files, (3,), scene units.
Offset = tuple[float, float, float]
NO_OFFSET: Offset = (0.0, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Calibration:
    """Image size, focal lengths and principal point: what all cameras have, with a pose or with distortion.

    width, height: image size, pixels. fx, fy: focal lengths, cx, cy: principal point, pixels; pixel (row 0, column 0)
    has its centre at image coordinate (0.5, 0.5). Coordinates given to a method may be numbers, NumPy arrays or
    tensors, and what comes back is the same.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    @property
    def parameters(self) -> tuple[float, float, float, float]:
        """(fx, fy, cx, cy), pixels: the order of COLMAP's PINHOLE camera."""
        return self.fx, self.fy, self.cx, self.cy

    @property
    def intrinsics(self) -> np.ndarray:
        """(3, 3) calibration matrix, pixels."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def resized(self, width: int, height: int) -> Self:
        """The same view with another number of pixels; each axis is scaled by its own factor."""
        sx, sy = width / self.width, height / self.height
        return replace(
            self, width=width, height=height, fx=self.fx * sx, fy=self.fy * sy, cx=self.cx * sx, cy=self.cy * sy
        )

    def binned(self, factor: int) -> Self:
        """The same view whose pixels are cells of factor x factor pixels; remaining rows and columns are cut off."""
        fx, fy, cx, cy = (value / factor for value in self.parameters)
        return replace(self, width=self.width // factor, height=self.height // factor, fx=fx, fy=fy, cx=cx, cy=cy)

    def cropped(self, margin: int) -> Self:
        """The same view without `margin` pixels at each border."""
        width, height = self.width - 2 * margin, self.height - 2 * margin
        return replace(self, width=width, height=height, cx=self.cx - margin, cy=self.cy - margin)

    def pixels(self, x: Any, y: Any, z: Any) -> tuple[Any, Any]:
        """Image coordinates of points in the camera's frame, scene units, without distortion."""
        return self.fx * x / z + self.cx, self.fy * y / z + self.cy

    def inside(self, xy: np.ndarray) -> np.ndarray:
        """(P,) bool: which image coordinates (P, 2) fall on a pixel; NaN, of a point behind the camera, on none."""
        with np.errstate(invalid="ignore"):
            return (xy >= 0).all(axis=1) & (xy[:, 0] < self.width) & (xy[:, 1] < self.height)

    def rays(self, column: Any, row: Any) -> tuple[Any, Any]:
        """(x / z, y / z) of what is seen at image coordinates, pixels, without distortion."""
        return (column - self.cx) / self.fx, (row - self.cy) / self.fy


@dataclass(frozen=True, eq=False)
class Camera(Calibration):
    """A pinhole camera without distortion.

    width, height: image size, pixels. fx, fy, cx, cy: pixels; pixel (row 0, column 0) has its
    centre at image coordinate (0.5, 0.5). world_to_camera: (4, 4) float64, rigid; camera axes are
    OpenCV's (x right, y down, z forward). Raises ValueError for a matrix of another shape.
    """

    world_to_camera: np.ndarray

    def __post_init__(self) -> None:
        matrix = np.array(self.world_to_camera, dtype=np.float64)
        if matrix.shape != (4, 4):
            raise ValueError(f"world_to_camera: expected shape (4, 4), found {matrix.shape}")
        matrix.setflags(write=False)
        object.__setattr__(self, "world_to_camera", matrix)

    def __repr__(self) -> str:
        place = ", ".join(f"{value:.4g}" for value in self.centre)
        focal = f"fx {self.fx:.6g}, fy {self.fy:.6g}"
        return f"{type(self).__name__}({self.width} x {self.height} px, {focal}, at ({place}))"

    @property
    def camera_to_world(self) -> np.ndarray:
        """(4, 4) inverse of world_to_camera."""
        rotation, translation = self.world_to_camera[:3, :3], self.world_to_camera[:3, 3]
        inverse = np.eye(4)
        inverse[:3, :3] = rotation.T
        inverse[:3, 3] = -rotation.T @ translation
        return inverse

    @property
    def centre(self) -> np.ndarray:
        """(3,) camera position in world coordinates."""
        return self.camera_to_world[:3, 3]

    def moved(self, by: Offset) -> Self:
        """The same camera at its position plus `by`, scene units, computed in float64; itself for no offset."""
        if by == NO_OFFSET:
            return self
        pose = self.world_to_camera.copy()
        pose[:3, 3] -= pose[:3, :3] @ np.array(by)
        return replace(self, world_to_camera=pose)

    def lifted(self, columns: np.ndarray, rows: np.ndarray, z: np.ndarray) -> np.ndarray:
        """(P, 3) world points that these pixels (P,) show at their centres, at z (P,), scene units."""
        x, y = self.rays(columns + 0.5, rows + 0.5)
        local = np.stack([x * z, y * z, z, np.ones_like(z)], axis=1)
        return np.asarray((local @ self.camera_to_world.T)[:, :3])

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Project world points (P, 3). Returns image coordinates (P, 2), pixels, and depth (P,).

        A point at or behind the camera plane (depth <= 0) gets NaN coordinates.
        """
        local = points @ self.world_to_camera[:3, :3].T + self.world_to_camera[:3, 3]
        depth = local[:, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            xy = np.stack(self.pixels(local[:, 0], local[:, 1], depth), axis=1)
        xy[depth <= 0] = np.nan
        return xy, depth
