"""Choose the Mitsuba variant that works on this machine, by a trial in another process, which may crash."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

from dofbench.core.errors import InputError

VECTORISED, SCALAR = "llvm_ad_rgb", "scalar_rgb"
# Older versions of LLVM load, but abort the whole process at the first render.
_LLVM_OLDEST = 17
_LIBRARY_FOLDERS = (
    "/usr/lib/x86_64-linux-gnu",
    "/usr/lib/aarch64-linux-gnu",
    "/usr/lib64",
    "/usr/lib",
    "/usr/local/lib",
    "/opt/homebrew/opt/llvm/lib",
)
_PROBE = (
    "import mitsuba as mi; mi.set_variant('llvm_ad_rgb');"
    "print(mi.render(mi.load_dict(mi.cornell_box() | {'integrator': {'type': 'direct'}}), spp=1).numpy().mean())"
)


def choose_variant(wanted: str = "auto") -> tuple[str, str]:
    """Select Mitsuba's variant: the vectorised one if a trial succeeds. Returns (variant, remark).

    wanted: "auto" or a variant's name. remark: why the slow scalar variant was selected, or empty. Sets
    DRJIT_LIBLLVM_PATH to a library that works. Raises InputError without mitsuba, for an unknown variant, and for the
    vectorised one by name where no LLVM library works.
    """
    try:
        import mitsuba as mi
    except ImportError as error:
        raise InputError("mitsuba", f"not importable ({error})", "the extra: pip install 'dofbench[render]'") from error

    if wanted not in ("auto", *mi.variants()):
        raise InputError("variant", wanted, f"auto or one of {', '.join(mi.variants())}")
    variant, remark = wanted, ""
    if wanted in ("auto", VECTORISED):
        library, tried = _find_llvm()
        if library:
            variant = VECTORISED
            os.environ["DRJIT_LIBLLVM_PATH"] = library
        elif wanted == VECTORISED:
            raise InputError(VECTORISED, tried, f"libLLVM {_LLVM_OLDEST} or newer (DRJIT_LIBLLVM_PATH), or {SCALAR}")
        else:
            variant = SCALAR
            remark = f"{tried}: rendering with {SCALAR}, several times slower (DRJIT_LIBLLVM_PATH names a library)"
    mi.set_variant(variant)
    mi.set_log_level(mi.LogLevel.Error)
    return variant, remark


def _find_llvm() -> tuple[str | None, str]:
    """Path of an LLVM library with which a trial render works, newest first; None, and why, when there is none."""
    given = os.environ.get("DRJIT_LIBLLVM_PATH")
    candidates = [given] if given else _installed_llvm()
    for library in candidates:
        trial = subprocess.run(
            [sys.executable, "-P", "-c", _PROBE],
            env=os.environ | {"DRJIT_LIBLLVM_PATH": library},
            capture_output=True,
            check=False,
        )
        if trial.returncode == 0:
            return library, ""
    if candidates:
        return None, f"a trial render failed with {', '.join(candidates)}"
    return None, f"no libLLVM {_LLVM_OLDEST} or newer"


def _installed_llvm() -> list[str]:
    found: dict[int, str] = {}
    for folder in _LIBRARY_FOLDERS:
        for path in Path(folder).glob("libLLVM*"):
            version = re.search(r"(\d+)", path.name.replace("libLLVM", ""))
            if version and int(version[1]) >= _LLVM_OLDEST:
                found.setdefault(int(version[1]), str(path))
    return [found[version] for version in sorted(found, reverse=True)]
