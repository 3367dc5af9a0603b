"""torch's devices: reading a device's name, listing this machine's devices, and choosing one for a call."""

from __future__ import annotations

from collections.abc import Sequence

from dofbench.core.errors import InputError

# torch's names for the kinds of device that dofbench supports.
KINDS = ("cpu", "cuda")


def kind_of(name: str) -> str:
    """The kind of the device called `name`, one of `KINDS`: "cuda" of "cuda:1".

    Raises InputError for any other name.
    """
    kind, colon, number = name.partition(":")
    if kind not in KINDS or (colon and not number.isdecimal()):
        raise InputError("device", repr(name), f"one of {', '.join(KINDS)}, or one of several as in cuda:1")
    return kind


def count(kind: str) -> int:
    """How many devices of a kind this machine has; the CPU counts as one."""
    if kind == "cpu":
        return 1
    import torch

    return torch.cuda.device_count() if torch.cuda.is_available() else 0


def kinds_here() -> tuple[str, ...]:
    """The kinds of device that this machine has, the CPU first."""
    return tuple(kind for kind in KINDS if count(kind))


def describe(name: str) -> str | None:
    """The product name of the device called `name`, as its maker calls it; None for the CPU."""
    if kind_of(name) == "cpu":
        return None
    import torch

    return torch.cuda.get_device_name(name)


def resolve(wanted: str, runs_on: Sequence[str], who: str) -> str:
    """The device to use when `wanted` is asked for: a device's name, or "auto" for the best kind in `runs_on`.

    runs_on: kinds of device that can be used, as a method's card lists them. who: what needs the device, for the
    message. Raises InputError if `wanted` isn't a device's name, isn't in `runs_on`, or this machine has no such
    device.
    """
    if wanted == "auto":
        here = [kind for kind in reversed(KINDS) if kind in runs_on and count(kind)]
        if not here:
            raise InputError("--device", f"auto, and none of {', '.join(runs_on)} here", f"what {who} runs on")
        return here[0]
    known = wanted.partition(":")[0] in KINDS
    if not known or kind_of(wanted) not in runs_on:
        raise InputError("--device", repr(wanted), f"auto or what {who} runs on: {', '.join(runs_on)}")
    kind, _, number = wanted.partition(":")
    if int(number or 0) >= count(kind):
        there = f"{count(kind)} of them" if count(kind) else "none"
        raise InputError("--device", f"{wanted!r}, and {there} here", f"auto or one of {', '.join(kinds_here())}")
    return wanted
