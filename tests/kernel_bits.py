"""A call of every function of every kernel with its gradient, and a digest of the bits that come out.

    python tests/kernel_bits.py "tone cpu cpu float32" ...     # op, backend, device, type: one line of JSON, by these

A program, so that the same calls can be compared between processes and numbers of threads.
"""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import torch
from random_gaussians import render, scene, view
from torch import Tensor

from dofbench.runtime.devices import kinds_here
from dofbench.runtime.factored_grid import GridShape
from dofbench.runtime.ops import backend_of, backends, load, ops

# Large enough for torch to split a sum among threads (from 32 768 numbers on) and for several of each kernel's blocks.
HEIGHT, WIDTH = 130, 310


def ssim(load: Callable[..., Callable[..., Tensor]], to: Callable[[Tensor], Tensor]) -> Iterator[Tensor]:
    target, weight = to(torch.rand(HEIGHT, WIDTH, 3)), to(torch.rand(HEIGHT, WIDTH))
    weighted = {"ssim_weight": 0.2, "weight": weight}
    changed = ({}, {"weigh_all": True}, {"weigh_all": True, "edge_weight": 1.0})
    for function, options in (("ssim", {}), *(("l1_ssim", weighted | change) for change in changed)):
        prediction = to(torch.rand(HEIGHT, WIDTH, 3)).requires_grad_()
        value = load(function)(prediction, target, **options)
        value.backward()
        yield from (value, prediction.grad)


def scatter(load: Callable[..., Callable[..., Tensor]], to: Callable[[Tensor], Tensor]) -> Iterator[Tensor]:
    for form in ("direct", "linear"):
        image = to(torch.rand(HEIGHT, WIDTH, 3)).requires_grad_()
        radius = to(torch.rand(HEIGHT, WIDTH) * 8 - 4).requires_grad_()
        blurred = load("scatter")(image, radius, form=form)
        (blurred * to(torch.rand(HEIGHT, WIDTH, 3))).sum().backward()
        yield from (blurred, image.grad, radius.grad)


def rasterize(load: Callable[..., Callable[..., Tensor]], to: Callable[[Tensor], Tensor]) -> Iterator[Tensor]:
    gaussians = scene(400, seed=5)
    outputs, gradients, statistics = render(load("rasterize"), gaussians, to(torch.zeros(1)).dtype, camera=view(70, 60))
    yield from (output for output in outputs if output is not None)
    yield from gradients.values()
    yield from (statistics.visible, statistics.radii, statistics.grad_2d, statistics.abs_grad_2d)
    inputs = {name: to(value).requires_grad_() for name, value in gaussians.items()}
    radius = to(torch.rand(400) * 8 - 4).requires_grad_()
    points = np.array([[0.0, 0.5], [-0.5, 0.0], [0.5, -0.5]])
    images = load("rasterize_from_points")(**inputs, camera=view(70, 60), points=points, radius=radius)
    images.square().sum().backward()
    yield images
    yield from (value.grad for value in (*inputs.values(), radius))


def stereo(load: Callable[..., Callable[..., Any]], to: Callable[[Tensor], Tensor]) -> Iterator[Tensor]:
    image, other = to(torch.rand(60, 90)), to(torch.rand(2, 60, 90))
    maps = torch.eye(3, 4, dtype=torch.float64).repeat(2, 1, 1)
    maps[:, 0, 3] = torch.tensor([6.0, -4.0])
    scores = load("stereo")(image, other, maps, to(torch.linspace(0.1, 1.0, 9)), radius=3, best=2)
    load("upsample")(scores, to(torch.rand(30, 45, 5)), 0.3)
    yield scores
    plane, score, margin = load("semiglobal")(scores, image, small=0.1, large=0.8, edge=0.1)
    yield from (plane, score, margin)
    depth = 2 + to(torch.rand(60, 90))
    there, back = torch.eye(3, 4, dtype=torch.float64), torch.eye(3, 4, dtype=torch.float64)
    yield load("returns")(depth, depth.flip(0).contiguous(), there, back, pixels=1.0, share=0.1)


def tone(load: Callable[..., Callable[..., Tensor]], to: Callable[[Tensor], Tensor]) -> Iterator[Tensor]:
    values = to(torch.rand(HEIGHT, WIDTH, 3)).requires_grad_()
    decoded = load("tone")(values, 2.2, 0.01, 0.01**1.2)
    decoded.sum().backward()
    yield from (decoded, values.grad)


def mix(load: Callable[..., Callable[..., Tensor]], to: Callable[[Tensor], Tensor]) -> Iterator[Tensor]:
    image, logits = (to(torch.rand(size)).requires_grad_() for size in ((70, 60, 3), (70, 60, 49)))
    mixed = load("mix")(image, logits)
    (mixed * to(torch.rand(70, 60, 3))).sum().backward()
    yield from (mixed, image.grad, logits.grad)


def field(load: Callable[..., Callable[..., Any]], to: Callable[[Tensor], Tensor]) -> Iterator[Tensor]:
    shape, rays, each = GridShape((9, 8, 7), 8, 8, 4), 400, 100
    sizes = ((shape.density_size,), (shape.colour_size,), shape.basis_shape, (rays, 3), (rays, 3))
    inputs = [to(torch.rand(size)).requires_grad_() for size in sizes]
    views = to(torch.nn.functional.normalize(torch.rand(rays, 3), dim=1)).requires_grad_()
    starts = each * torch.arange(rays + 1, device=views.device)
    places, lengths = to(torch.linspace(0, 1, each).repeat(rays)), to(torch.rand(rays * each))
    seen = load("field")(*inputs, views, starts, places, lengths, shape=shape, shift=-4.0, least_weight=1e-3)
    (seen.color.sum() + seen.opacity.sum() + seen.distance.sum()).backward()
    yield from (seen.color, seen.opacity, seen.distance, *(value.grad for value in (*inputs, views)))
    cells, spans = to(torch.rand(5, 6, 7)) > 0.5, to(torch.tensor([0.0, 1.0])).expand(rays, 2)
    samples = load("field_samples")(inputs[3], inputs[4], spans, to(torch.rand(rays)), cells, count=each)
    yield from (samples.starts, samples.places, samples.steps)
    yield load("field_density")(inputs[0], inputs[3].detach(), shape=shape, shift=-4.0)
    stored = load("field_features")(*inputs[:2], to(torch.rand(3000, 3)), shape=shape)
    yield stored
    yield from torch.autograd.grad(stored.square().sum(), inputs[:2])


def adam(load: Callable[..., Callable[..., Any]], to: Callable[[Tensor], Tensor]) -> Iterator[Tensor]:
    # More than one launch takes, and one of them with a gradient by some rows alone.
    values, gradients, first = ([to(torch.rand(HEIGHT, WIDTH)) - 0.5 for _ in range(8)] for _ in range(3))
    second = [to(torch.rand(HEIGHT, WIDTH)) for _ in range(8)]
    gradients[3] = gradients[3][5:9]
    rows = [2 if number == 3 else 0 for number in range(8)]
    for step in (3, 4):
        load("adam")(values, gradients, first, second, steps=[step] * 8, lrs=[0.1] * 8, eps=1e-15, rows=rows)
    yield from (*values, *first, *second)


def surface(load: Callable[..., Callable[..., Tensor]], to: Callable[[Tensor], Tensor]) -> Iterator[Tensor]:
    depth, alpha = to(torch.rand(HEIGHT, WIDTH) + 1).requires_grad_(), to(torch.rand(HEIGHT, WIDTH))
    lens = [to(torch.tensor(value)).requires_grad_() for value in (0.7, -0.3)]
    disparity = load("surface")(depth, alpha, 0.1)
    radius = load("circle")(disparity, *lens, low=0.4, extent=0.5, scale=6.0)
    # Many of them in a pixel that another has too.
    at = torch.randint(HEIGHT * WIDTH, (40_000,), device=depth.device).sort().values
    samples = at // WIDTH, at % WIDTH, to(torch.rand(len(at)) + 1), to(torch.rand(len(at)))
    options = {"most": int(at.bincount().max()), "least_alpha": 0.1, "extent": 0.5}
    errors = [
        load("known_depth")(depth, alpha, *samples, None, squared=squared, **options) for squared in (False, True)
    ]
    (radius.square().sum() + sum(errors)).backward()
    yield from (disparity, radius, *errors, depth.grad, *(one.grad for one in lens))


def colours(load: Callable[..., Callable[..., Tensor]], to: Callable[[Tensor], Tensor]) -> Iterator[Tensor]:
    image, change = (to(torch.rand(size)).requires_grad_() for size in ((HEIGHT, WIDTH, 3), (3, 4)))
    changed = load("colours")(image, change)
    changed.square().sum().backward()
    yield from (changed, image.grad, change.grad)


CALLS: dict[str, Callable[..., Iterator[Tensor]]] = {
    "ssim": ssim,
    "scatter": scatter,
    "rasterize": rasterize,
    "stereo": stereo,
    "tone": tone,
    "mix": mix,
    "field": field,
    "adam": adam,
    "surface": surface,
    "colours": colours,
}


def digest(op: str, backend: str, device: str, dtype: str) -> str:
    """Of all that the op's functions give, and their gradients, by random inputs that are always the same."""
    torch.manual_seed(0)

    def function(name: str) -> Callable[..., Any]:
        return load(op, backend, function=name)

    def to(tensor: Tensor) -> Tensor:
        return tensor.to(device, getattr(torch, dtype))

    found = hashlib.sha256()
    for tensor in CALLS[op](function, to):
        found.update(tensor.detach().cpu().contiguous().numpy().tobytes())
    return found.hexdigest()


def every_call() -> Iterator[tuple[str, str, str, str]]:
    """(op, backend, device, type) of whatever can run on this machine."""
    for op in ops():
        for name in backends(op):
            backend = backend_of(op, name)
            for device in backend.devices:
                if device in kinds_here():
                    yield from ((op, name, device, dtype) for dtype in backend.dtypes)


if __name__ == "__main__":
    print(json.dumps({asked: digest(*asked.split()) for asked in sys.argv[1:]}))
