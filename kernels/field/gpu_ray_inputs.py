"""What the field's GPU backend asks of its arguments, and the sizes of its programs."""

from __future__ import annotations

import torch
from torch import Tensor

from dofbench.runtime.factored_grid import GridShape
from dofbench.runtime.gpu_launch import check_tensors

SAMPLES = 256  # of a program that has no channels in it


def channels_of(rank: int) -> int:
    """How many channels a program reads together; they divide the rank, a multiple of eight."""
    return 16 if rank % 16 == 0 else 8


def group(rank: int, elements: int, block: str = "BLOCK") -> dict[str, int]:
    """The constants of a program that has `elements` numbers in a block of samples and channels."""
    return {"RANK": rank, "CHANNELS": channels_of(rank), block: elements // channels_of(rank)}


def check(
    grids: dict[str, Tensor], rays: dict[str, Tensor], starts: Tensor, samples: dict[str, Tensor], shape: GridShape
) -> None:
    """Raise ValueError, naming the argument, for tensors of another type, device or shape.

    What they hold isn't looked at, since the host would have to wait for the device.
    """
    check_tensors("field", **grids, **rays, **samples)
    count, size = len(rays["origins"]), len(samples["places"])
    wanted: dict[str, tuple[int, ...]] = {
        "density": (shape.density_size,),
        "colour": (shape.colour_size,),
        "basis": shape.basis_shape,
        **dict.fromkeys(rays, (count, 3)),
        **dict.fromkeys(samples, (size,)),
    }
    for name, tensor in (grids | rays | samples).items():
        if tuple(tensor.shape) != wanted[name]:
            raise ValueError(f"field {name}: expected {wanted[name]}, found {tuple(tensor.shape)}")
    if starts.dtype != torch.int64 or tuple(starts.shape) != (count + 1,) or starts.device != rays["origins"].device:
        found = f"{starts.dtype} {tuple(starts.shape)} on {starts.device}"
        raise ValueError(f"field starts: expected int64 {(count + 1,)} beside the rays, found {found}")
    if size and not count:
        raise ValueError(f"field starts: expected no samples without a ray, found {size}")
