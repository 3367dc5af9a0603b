"""Numbers of the host on the device of a tensor."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor


def beside(tensor: Tensor, values: Any) -> Tensor:
    """Numbers, or an array of them, as a tensor of the type of `tensor` and on its device.

    Unlike `Tensor.new_tensor`, it doesn't have the host wait until the device has done all that it was asked before.
    """
    return torch.tensor(np.array(values), dtype=tensor.dtype).to(tensor.device, non_blocking=True)
