"""Triton kernels of the spherical harmonics that a colour depends on: a program for a block of rays."""

from __future__ import annotations

import triton
import triton.language as tl

from .gpu_stencil import three_of


@triton.jit(do_not_specialize=["size"])
def harmonics(views, terms, size, COUNT: tl.constexpr, BLOCK: tl.constexpr):
    """terms: (R, COUNT), as in `reference.harmonics`."""
    ray = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    inside = ray < size
    x, y, z = three_of(views, ray, inside)
    to = terms + ray * COUNT
    tl.store(to, tl.full((BLOCK,), 0.28209479177387814, tl.float32), mask=inside)
    if COUNT > 1:
        tl.store(to + 1, 0.4886025119029199 * y, mask=inside)
        tl.store(to + 2, 0.4886025119029199 * z, mask=inside)
        tl.store(to + 3, 0.4886025119029199 * x, mask=inside)
    if COUNT > 4:
        tl.store(to + 4, 1.0925484305920792 * x * y, mask=inside)
        tl.store(to + 5, 1.0925484305920792 * y * z, mask=inside)
        tl.store(to + 6, 0.31539156525252005 * (2.0 * z * z - x * x - y * y), mask=inside)
        tl.store(to + 7, 1.0925484305920792 * x * z, mask=inside)
        tl.store(to + 8, 0.5462742152960396 * (x * x - y * y), mask=inside)


@triton.jit(do_not_specialize=["size"])
def harmonics_backward(views, by_terms, by_views, size, COUNT: tl.constexpr, BLOCK: tl.constexpr):
    """by_views: (R, 3), from the gradient by the terms."""
    ray = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    inside = ray < size
    by_x, by_y, by_z = tl.zeros((BLOCK,), tl.float32), tl.zeros((BLOCK,), tl.float32), tl.zeros((BLOCK,), tl.float32)
    come = by_terms + ray * COUNT
    if COUNT > 1:
        by_x += 0.4886025119029199 * tl.load(come + 3, mask=inside, other=0.0)
        by_y += 0.4886025119029199 * tl.load(come + 1, mask=inside, other=0.0)
        by_z += 0.4886025119029199 * tl.load(come + 2, mask=inside, other=0.0)
    if COUNT > 4:
        x, y, z = three_of(views, ray, inside)
        xy, yz = tl.load(come + 4, mask=inside, other=0.0), tl.load(come + 5, mask=inside, other=0.0)
        xz, squares = tl.load(come + 7, mask=inside, other=0.0), tl.load(come + 8, mask=inside, other=0.0)
        zonal = 0.6307831305050401 * tl.load(come + 6, mask=inside, other=0.0)
        by_x += 1.0925484305920792 * (y * xy + z * xz + x * squares) - zonal * x
        by_y += 1.0925484305920792 * (x * xy + z * yz - y * squares) - zonal * y
        by_z += 1.0925484305920792 * (y * yz + x * xz) + 2.0 * zonal * z
    tl.store(by_views + 3 * ray, by_x, mask=inside)
    tl.store(by_views + 3 * ray + 1, by_y, mask=inside)
    tl.store(by_views + 3 * ray + 2, by_z, mask=inside)
