"""Provenance of a result: code, commit, machine, packages; and the peak memory of the process."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import re
import resource
import subprocess
import tomllib
from contextlib import suppress
from pathlib import Path
from typing import Any

import dofbench
from dofbench.core.content import method_folders
from dofbench.core.files import canonical_json, sha256_text
from dofbench.core.source_digest import package_digest, source_digest
from dofbench.runtime.devices import describe

_PACKAGE = Path(dofbench.__file__).resolve().parent
# Entries of a method's card that affect scores; presets and stages only choose options
_STEERS = ("class", "capabilities")
_IMPORTED = re.compile(r"\bdofbench\.methods\.(\w+)")  # in the source of a method


def code_version(method_folder: Path, device: str) -> str:
    """`<package version>+<sha256>` over the code that can change a score on this device.

    That is `source_digest.SCORED`, all kernels, the method's folder and those that it builds on, with class and
    capabilities of their cards. Options are part of a run's key instead.
    """
    folders = _method_code(method_folder)
    steering = [{key: _card(folder).get(key) for key in _STEERS} for folder in folders]
    parts = [package_digest(device=device), source_digest(folders), canonical_json(steering)]
    return f"{dofbench.__version__}+{sha256_text(chr(10).join(parts))}"


def _method_code(folder: Path) -> list[Path]:
    """The method's folder, and those of the methods that it is `like` or imports from, theirs included."""
    found = [folder]
    for one in found:  # which grows
        source = "".join(file.read_text(encoding="utf-8") for file in sorted(one.rglob("*.py")))
        for name in [_card(one).get("like", ""), *sorted(set(_IMPORTED.findall(source)))]:
            others = [root / name for root in method_folders() if (root / name / "method.toml").is_file()]
            found += [other for other in others if other not in found]
    return found


def _card(folder: Path) -> dict[str, Any]:
    return tomllib.loads((folder / "method.toml").read_text(encoding="utf-8"))


def git_state() -> dict[str, str | bool] | None:
    """{"commit": …, "dirty": …} of the checkout that this package runs from; None outside a checkout."""
    root = _PACKAGE.parent
    if not (root / ".git").exists():
        return None

    def git(*words: str) -> str:
        done = subprocess.run(["git", "-C", str(root), *words], capture_output=True, text=True, check=True)
        return done.stdout.strip()

    try:
        return {"commit": git("rev-parse", "HEAD"), "dirty": bool(git("status", "--porcelain"))}
    except (OSError, subprocess.CalledProcessError):  # git isn't installed, or the repository has no commit yet
        return None


def machine(device: str) -> dict[str, str | int | float]:
    """CPU, cores, threads, memory (GiB), operating system, Python, and the accelerator if one is used."""
    pages, page_size = os.sysconf("SC_PHYS_PAGES"), os.sysconf("SC_PAGE_SIZE")
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    described: dict[str, str | int | float] = {
        "cpu": _cpu_model(),
        "cores": cores,
        "threads": _threads(cores),
        "memory_gib": round(pages * page_size / 2**30, 1),
        "os": platform.platform(),
        "python": platform.python_version(),
        "device": device,
    }
    if accelerator := describe(device):
        described["accelerator"] = accelerator
    return described


def _threads(cores: int) -> int:
    told = os.environ.get("NUMBA_NUM_THREADS") or os.environ.get("OMP_NUM_THREADS", "").split(",")[0]
    return int(told) if told.isdigit() else cores


def package_versions() -> dict[str, str]:
    """Installed versions of dofbench and its dependencies."""
    versions = {"dofbench": dofbench.__version__}
    for requirement in _requirements():
        name = re.split(r"[^\w.-]", requirement, maxsplit=1)[0]
        try:
            versions[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:  # an optional extra that isn't installed
            continue
    return dict(sorted(versions.items()))


def _requirements() -> list[str]:
    try:
        return importlib.metadata.requires("dofbench") or []
    except importlib.metadata.PackageNotFoundError:  # run from a checkout that isn't installed
        project = tomllib.loads((Path(dofbench.__file__).parents[1] / "pyproject.toml").read_text())["project"]
        return [*project["dependencies"], *project["optional-dependencies"]["gpu"]]


def reset_peak_memory() -> None:
    """Reset the process's peak memory, if the system allows it (Linux), for a second run in the same process."""
    with suppress(OSError):  # not Linux, or not permitted
        Path("/proc/self/clear_refs").write_text("5")


def peak_memory_mb() -> float:
    """Peak resident memory of the process, MB (10^6 bytes)."""
    try:
        found = re.search(r"^VmHWM:\s+(\d+) kB", Path("/proc/self/status").read_text(), re.MULTILINE)
    except OSError:
        found = None
    if found:
        return int(found[1]) * 1024 / 1e6
    # ru_maxrss is in KiB, except on macOS, where it is in bytes.
    unit = 1 if platform.system() == "Darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6


def _cpu_model() -> str:
    try:
        found = re.search(r"^model name\s*:\s*(.+)$", Path("/proc/cpuinfo").read_text(), re.MULTILINE)
    except OSError:
        found = None
    return found[1] if found else platform.processor() or platform.machine()
