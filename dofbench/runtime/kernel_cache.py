"""Compiled kernels on disk, recompiled when any source that they were compiled from changes.

Each function has one file for each combination of argument types, processor and sources, whose name holds a digest of
these. A file is written under a temporary name and renamed, so processes may compile the same function at once. The
folder is numba's: `NUMBA_CACHE_DIR`, else `__pycache__` next to the source, else `~/.cache/numba`. Where the first of
these that applies can't be written, as in the image of a container, code is read there and new code stored in the next.
"""

from __future__ import annotations

import os
import pickle
import sys
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any, Protocol

import numba
from numba import njit
from numba.core.caching import CompileResultCacheImpl, FunctionCache, InTreeCacheLocator, UserProvidedCacheLocator
from numba.core.cpu_options import ParallelOptions
from numba.core.registry import cpu_target
from numba.core.serialize import dumps

from dofbench.core.errors import InputError
from dofbench.core.files import replacing
from dofbench.core.source_digest import PACKAGE, source_digest
from dofbench.runtime.backend import Backend

_IMPLICIT = ("comprehension", "reduction", "inplace_binop", "setitem", "numpy", "stencil")
# For `njit(parallel=...)`: loops over `prange` alone. Numba would make a loop over threads of each `np.zeros` too, and
# each such loop takes half a second to compile.
PRANGE = ParallelOptions(dict.fromkeys(_IMPLICIT, False))

_compiled = 0
_caches: list[_SourceCache] = []


class Dispatcher(Protocol):
    """What of numba's compiled functions is used here."""

    py_func: Callable[..., object]
    _cache: object
    targetoptions: dict[str, object]

    def __call__(self, *arguments: Any, **options: Any) -> Any:
        """Run it on arguments of any types, compiled for these."""


class _FirstChoice:
    """The last of numba's places: the first one, which can't be written."""

    @staticmethod
    def from_function(function: Callable[..., object], file: str) -> Any:
        kind = UserProvidedCacheLocator if numba.config.CACHE_DIR else InTreeCacheLocator
        return kind(function, file)


class _Place(CompileResultCacheImpl):
    """Where a function's code is, and how its files are called: without the line's number, which the digest implies."""

    _locator_classes = (*CompileResultCacheImpl._locator_classes, _FirstChoice)

    def get_filename_base(self, fullname: str, abiflags: str) -> str:
        major, minor, *_ = sys.version_info
        return f"{fullname.replace('<', '').replace('>', '')}.py{major}{minor}{abiflags}"


class _Files:
    """The files of one function.

    folders: read in this order; the first is also written. base: how the names of all files begin. stamp: digest of
    sources and version, without which a file is stale. A content follows its sha256: one flipped bit in machine code
    would go unnoticed.
    """

    def __init__(self, folders: tuple[Path, ...], base: str, stamp: str) -> None:
        self._folders, self._base, self._stamp = folders, base, stamp

    def _prefix(self, processor: object) -> str:
        return f"{self._base}.{self._stamp}.{_digest(processor, 8)}."

    def _name(self, key: tuple[Any, ...]) -> str:
        types, processor, code = key
        return f"{self._prefix(processor)}{_digest((types, code), 16)}.nbc"

    def load(self, key: tuple[Any, ...]) -> Any:
        for folder in self._folders:
            with suppress(Exception):  # a damaged pickle raises anything
                content = (folder / self._name(key)).read_bytes()
                if sha256(content[32:]).digest() == content[:32]:
                    return pickle.loads(content[32:])
        return None

    def save(self, key: tuple[Any, ...], data: object) -> None:
        content: bytes = dumps(data)
        folder = self._folders[0]
        with replacing(folder / self._name(key)) as temporary:
            temporary.write_bytes(sha256(content).digest() + content)
        for file in folder.glob(f"{self._base}.*"):
            if not file.name.startswith(f"{self._base}.{self._stamp}."):
                file.unlink(missing_ok=True)

    def stored(self, processor: object) -> list[Path]:
        """The files with code for this processor, whatever the types of the arguments."""
        return [file for folder in self._folders for file in folder.glob(f"{self._prefix(processor)}*.nbc")]


def _digest(content: object, digits: int) -> str:
    return sha256(repr(content).encode()).hexdigest()[:digits]


class _SourceCache(FunctionCache):
    """Numba's cache over `_Files`. What can't be read or written is compiled anew."""

    _impl_class = _Place
    _impl: Any
    _cache_path: str
    _cache_file: Any

    def __init__(self, function: Callable[..., object], digest: str) -> None:
        super().__init__(function)
        first = _FirstChoice.from_function(function, function.__code__.co_filename).get_cache_path()
        folders = tuple(Path(folder) for folder in dict.fromkeys((self._cache_path, first)))
        self._cache_file = _Files(folders, self._impl.filename_base, _digest((digest, numba.__version__), 12))
        self.writable = os.access(self._cache_path, os.W_OK)

    def load_overload(self, sig: object, target_context: object) -> Any:
        try:
            return super().load_overload(sig, target_context)
        except Exception:  # whole, but of another version of a library
            return None

    def save_overload(self, sig: object, data: object) -> None:
        global _compiled
        _compiled += 1
        with suppress(OSError, InputError):  # a full disk, or a folder that became read-only, or has the file's name
            super().save_overload(sig, data)


def cached(dispatcher: Dispatcher) -> Dispatcher:
    """Keep an `njit` function's machine code on disk; a decorator to put above `njit`.

    Numba's own `cache=True` looks at the function's file only, and goes on using old code after a change in a module
    that the function calls into or takes constants from. Here a function is recompiled when any source changes in its
    own folder or in the packages `compute` and `core`. Without a writable cache folder it is compiled in every process.
    """
    code = _code(Path(dispatcher.py_func.__code__.co_filename).parent)
    dispatcher._cache = cache = _SourceCache(dispatcher.py_func, code)
    _caches.append(cache)
    dispatcher.targetoptions["no_cfunc_wrapper"] = True  # only Python and compiled functions call it
    return dispatcher


def internal(**options: Any) -> Callable[[Callable[..., object]], Any]:
    """`njit` for functions that compiled functions alone call: without the wrappers by which Python and C would call
    them, which take a good part of the time to compile a small function. A call from Python ends the process."""
    return njit(no_cpython_wrapper=True, no_cfunc_wrapper=True, **options)


@cache
def _code(folder: Path) -> str:
    return source_digest([folder, PACKAGE / "runtime", PACKAGE / "core"], deep=False)


def compiled() -> int:
    """How many functions this process has compiled and stored on disk, rather than loaded from there."""
    return _compiled


def add_compiled(count: int) -> None:
    """Count functions that another process has compiled for this one."""
    global _compiled
    _compiled += count


def stored() -> list[Path]:
    """The files of all functions that have been imported, with code for this processor from the present sources."""
    return [file for cache in _caches for file in cache._cache_file.stored(_processor())]


def processor() -> str:
    """The processor that code is compiled for, as LLVM calls it."""
    name: str = _processor()[1]
    return name


def _processor() -> tuple[str, str, str]:
    target: tuple[str, str, str] = cpu_target.target_context.codegen().magic_tuple()
    return target


def is_compiled(dispatcher: Dispatcher) -> bool:
    """Whether a `cached` function is on disk, compiled for this processor from the present sources, for any types.

    Also true where nothing can be stored on disk: compiling in another process would be of no use there.
    """
    cache = dispatcher._cache
    assert isinstance(cache, _SourceCache)
    return not cache.writable or bool(cache._cache_file.stored(_processor()))


def cpu_backend(warm_up: Callable[..., None], *functions: Dispatcher) -> Backend:
    """The declaration of a backend in numba: float32 on the CPU, the same bits in every run.

    functions: `cached` ones that a warm-up compiles last, by which `is_warm` decides.
    """
    return Backend(("cpu",), ("float32",), True, warm_up, lambda: all(map(is_compiled, functions)))
