"""Compiled kernels on disk, forgotten when any source that they are made of changes."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from numba.core.caching import FunctionCache

from dofbench.core.import_closure import Sources, closure_digest, own_sources

_compiled = 0


class _SourceCache(FunctionCache):
    """Numba's cache, whose keys also hold a digest of the sources."""

    def __init__(self, py_func, digest: str) -> None:
        super().__init__(py_func)
        self._digest = digest

    def save_overload(self, sig, data):
        global _compiled
        _compiled += 1
        super().save_overload(sig, data)

    def _index_key(self, sig, codegen):
        return (*super()._index_key(sig, codegen), self._digest)


def cached(dispatcher):
    """Keep an `njit` function's machine code on disk; a decorator to put above `njit`.

    Numba's own `cache=True` looks at the function's file only, and goes on using old code after a change in a module
    that the function calls into or takes constants from. Here the code is forgotten when anything changes that the
    function's source reaches. Where nothing can be written, the function is compiled in every process.
    """
    with suppress(RuntimeError):  # numba's way to say that it found no writable folder
        dispatcher._cache = _SourceCache(dispatcher.py_func, _sources_of(dispatcher.py_func))
    return dispatcher


def _sources_of(function: Callable[..., object]) -> str:
    """A digest of all that the function's source reaches; of one outside this project, modules beside it included."""
    if own_sources().file(function.__module__):
        return closure_digest([function])
    file = Path(function.__code__.co_filename)
    beside = Sources({**own_sources().roots, "": file.parent})
    return closure_digest([f"{file.stem}:{function.__qualname__.partition('.')[0]}"], beside)


def compiled() -> int:
    """How many functions this process has compiled and put on disk, rather than found there."""
    return _compiled


def is_compiled(dispatcher) -> bool:
    """Whether code of a `cached` function, made of the present sources for any types, lies on disk.

    Also true where nothing can be kept on disk: then no other process's work would help.
    """
    cache = dispatcher._cache
    if not isinstance(cache, _SourceCache):
        return True
    return any(key[-1] == cache._digest for key in cache._cache_file._load_index())
