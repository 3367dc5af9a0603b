"""Compiled kernels on disk, recompiled when any source that they were compiled from changes."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any, Protocol

from numba.core.caching import FunctionCache, IndexDataCacheFile

from dofbench.core.source_digest import PACKAGE, source_digest
from dofbench.runtime.backend import Backend

_compiled = 0


class Dispatcher(Protocol):
    """What of numba's compiled functions is used here."""

    py_func: Callable[..., object]
    _cache: object

    def __call__(self, *arguments: Any, **options: Any) -> Any:
        """Run it on arguments of any types, compiled for these."""


class _CheckedFiles(IndexDataCacheFile):
    """Numba's index and data files, each behind the sha256 of its content: a damaged one is as good as none.

    One flipped bit in an index ends the program with an exception of any kind, and one in machine code without any.
    """

    def _dump(self, obj: object) -> bytes:
        content: bytes = super()._dump(obj)
        return sha256(content).digest() + content

    def _load_index(self) -> dict[Any, str]:
        try:
            with Path(self._index_path).open("rb") as stream:
                if pickle.load(stream) != self._version:
                    return {}
                stamp, overloads = _checked(stream.read())
        except Exception:  # a damaged pickle raises anything; a folder that can't be read is none
            return {}
        return overloads if stamp == self._source_stamp else {}

    def _load_data(self, name: str) -> Any:
        try:
            return _checked(Path(self._data_path(name)).read_bytes())
        except Exception as error:
            raise OSError(str(error)) from None  # on which numba compiles


def _checked(content: bytes) -> Any:
    digest, content = content[:32], content[32:]
    if sha256(content).digest() != digest:
        raise ValueError("damaged")
    return pickle.loads(content)


class _SourceCache(FunctionCache):
    """Numba's cache, whose keys also hold a digest of the sources. What can't be read or written is compiled anew."""

    _cache_file: Any

    def __init__(self, py_func: Callable[..., object], digest: str) -> None:
        super().__init__(py_func)
        self._digest, files = digest, self._cache_file
        base = Path(files._index_path).name.removesuffix(".nbi")
        self._cache_file = _CheckedFiles(self._cache_path, base, files._source_stamp)

    def load_overload(self, sig: object, target_context: object) -> Any:
        try:
            return super().load_overload(sig, target_context)
        except Exception:  # whole, but of another machine or version of a library
            return None

    def save_overload(self, sig: object, data: object) -> None:
        global _compiled
        _compiled += 1
        with suppress(OSError):  # a full disk, or a folder that became read-only
            super().save_overload(sig, data)

    def _index_key(self, sig: object, codegen: object) -> tuple[object, ...]:
        return (*super()._index_key(sig, codegen), self._digest)


def cached(dispatcher: Dispatcher) -> Dispatcher:
    """Keep an `njit` function's machine code on disk; a decorator to put above `njit`.

    Numba's own `cache=True` looks at the function's file only, and goes on using old code after a change in a module
    that the function calls into or takes constants from. Here a function is recompiled when any source changes in its
    own folder or in the packages `compute` and `core`. Without a writable cache folder it is compiled in every process.
    """
    with suppress(RuntimeError, OSError):  # raised by numba when it finds no writable folder
        dispatcher._cache = _SourceCache(
            dispatcher.py_func, _code(Path(dispatcher.py_func.__code__.co_filename).parent)
        )
    return dispatcher


@cache
def _code(folder: Path) -> str:
    return source_digest([folder, PACKAGE / "runtime", PACKAGE / "core"], deep=False)


def compiled() -> int:
    """How many functions this process has compiled and stored on disk, rather than loaded from there."""
    return _compiled


def is_compiled(dispatcher: Dispatcher) -> bool:
    """Whether machine code of a `cached` function, compiled from the present sources, is on disk for any types.

    Also true where nothing can be stored on disk: compiling in another process would be of no use there.
    """
    cache = dispatcher._cache
    if not isinstance(cache, _SourceCache):
        return True
    return any(key[-1] == cache._digest for key in cache._cache_file._load_index())


def cpu_backend(warm_up: Callable[..., None], *functions: Dispatcher) -> Backend:
    """The declaration of a backend in numba: float32 on the CPU, the same bits in every run.

    functions: `cached` ones that a warm-up compiles last, by which `is_warm` decides.
    """
    return Backend(("cpu",), ("float32",), True, warm_up, lambda: all(map(is_compiled, functions)))
