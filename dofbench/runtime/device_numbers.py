"""Numbers of the host on the device of a tensor."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor


def sent(values: Any, device: torch.device | str, dtype: torch.dtype = torch.float32) -> Tensor:
    """Numbers, or an array of them, as a tensor on a device.

    Unlike `torch.tensor(values, device=device)`, it doesn't have the host wait until the device has done all that it
    was asked before.
    """
    return torch.tensor(np.array(values), dtype=dtype).to(device, non_blocking=True)


def beside(tensor: Tensor, values: Any) -> Tensor:
    """The same of the type of a tensor and on its device, for which `Tensor.new_tensor` would have the host wait."""
    return sent(values, tensor.device, tensor.dtype)
