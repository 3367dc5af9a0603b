"""A dense workspace in COLMAP's layout, written from known depth, since COLMAP needs CUDA to make one."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from dofbench.core.cameras import Camera
from dofbench.scenes.export import write_colmap


def back_projected(camera: Camera, depth: np.ndarray) -> np.ndarray:
    """(M, 3) world points of the pixels of known depth."""
    rows, columns = np.nonzero(depth > 0)
    z = depth[rows, columns].astype(np.float64)
    local = np.stack(
        [(columns + 0.5 - camera.cx) / camera.fx * z, (rows + 0.5 - camera.cy) / camera.fy * z, z, np.ones_like(z)],
        axis=1,
    )
    return (local @ camera.camera_to_world.T)[:, :3]


def write_map(file: Path, depth: np.ndarray) -> None:
    """A depth map (H, W)."""
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(f"{depth.shape[1]}&{depth.shape[0]}&1&".encode() + depth.astype("<f4").tobytes())


def write_fused(file: Path, points: np.ndarray) -> None:
    """Points (M, 3) as stereo_fusion writes them: positions, normals, colours."""
    names = ("x", "y", "z", "nx", "ny", "nz")
    table = np.zeros(len(points), [(name, "<f4") for name in names] + [(c, "u1") for c in ("red", "green", "blue")])
    for axis, name in enumerate("xyz"):
        table[name] = points[:, axis]
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"element vertex {len(points)}",
        *(f"property float {name}" for name in names),
        *(f"property uchar {name}" for name in ("red", "green", "blue")),
        "end_header",
        "",
    ]
    file.write_bytes("\n".join(header).encode() + table.tobytes())


def write_workspace(
    folder: Path, names: Sequence[str], cameras: Sequence[Camera], depths: Sequence[np.ndarray], fused: np.ndarray
) -> None:
    """Write the whole workspace: sparse/ without a numbered folder, geometric maps of NAME.png, fused.ply."""
    write_colmap(folder, [f"{name}.png" for name in names], cameras, None)
    for file in (folder / "sparse/0").iterdir():
        file.replace(folder / "sparse" / file.name)
    for name, depth in zip(names, depths, strict=True):
        write_map(folder / "stereo/depth_maps" / f"{name}.png.geometric.bin", depth)
    write_fused(folder / "fused.ply", fused)
