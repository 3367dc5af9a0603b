"""The weights of an ONNX file's convolutions, without the package `onnx`: enough of protobuf's wire format for that.

Field numbers are those of onnx.proto3 (ModelProto, GraphProto, NodeProto, TensorProto).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from dofbench.core.errors import InputError

_GRAPH, _NODE, _INITIALIZER = 7, 1, 5
_INPUT, _OUTPUT, _OPERATION = 1, 2, 4
_DIMS, _TYPE, _NAME, _RAW = 1, 2, 8, 9
_TYPES: dict[int, np.dtype[np.floating]] = {1: np.dtype("<f4"), 10: np.dtype("<f2")}
_VARINT, _EIGHT_BYTES, _BYTES, _FOUR_BYTES = 0, 1, 2, 5


def convolutions(file: Path) -> list[tuple[np.ndarray, np.ndarray]]:
    """(weight, bias), float32, of each convolution in the order in which they run.

    Follows casts, which files of half precision have between weight and convolution. Raises
    InputError for a file that is no such network.
    """
    try:
        return _convolutions(file.read_bytes())
    except OSError as error:
        raise InputError(file, error.strerror or "no readable file", "an ONNX network") from None
    except (ValueError, KeyError, IndexError, UnicodeDecodeError) as error:
        raise InputError(file, f"no readable weights ({error})", "an ONNX network of convolutions") from None


def _convolutions(content: bytes) -> list[tuple[np.ndarray, np.ndarray]]:
    graph = next((value for number, value in _fields(content) if number == _GRAPH), None)
    if not isinstance(graph, bytes):
        raise ValueError("no graph")
    tensors: dict[str, np.ndarray] = {}
    nodes = []
    for number, value in _fields(graph):
        if number == _INITIALIZER:
            name, tensor = _tensor(value)
            tensors[name] = tensor
        elif number == _NODE:
            nodes.append(_strings(value))
    found = []
    for operation, inputs, outputs in nodes:
        if operation == "Cast" and inputs[0] in tensors:
            tensors[outputs[0]] = tensors[inputs[0]]
        elif operation == "Conv":
            weight = tensors[inputs[1]].astype(np.float32)
            bias = tensors[inputs[2]].astype(np.float32) if len(inputs) > 2 else np.zeros(len(weight), np.float32)
            found.append((weight, bias))
    return found


def _fields(content: bytes) -> Iterator[tuple[int, int | bytes]]:
    """(field number, value) of a message, values of eight and four bytes as bytes."""
    at = 0
    while at < len(content):
        key, at = _varint(content, at)
        number, kind = key >> 3, key & 7
        if kind == _VARINT:
            value, at = _varint(content, at)
            yield number, value
            continue
        if kind == _BYTES:
            size, at = _varint(content, at)
        elif kind in (_EIGHT_BYTES, _FOUR_BYTES):
            size = 8 if kind == _EIGHT_BYTES else 4
        else:
            raise ValueError(f"wire type {kind}")
        if at + size > len(content):
            raise ValueError("a message cut short")
        yield number, content[at : at + size]
        at += size


def _varint(content: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        byte = content[at]
        value |= (byte & 127) << shift
        at, shift = at + 1, shift + 7
        if byte < 128:
            return value, at


def _tensor(content: int | bytes) -> tuple[str, np.ndarray]:
    if not isinstance(content, bytes):
        raise ValueError("a tensor that is a number")
    shape, kind, name, raw = [], 0, "", b""
    for number, value in _fields(content):
        if number == _DIMS:
            shape += [value] if isinstance(value, int) else _packed(value)
        elif number == _TYPE and isinstance(value, int):
            kind = value
        elif number == _NAME and isinstance(value, bytes):
            name = value.decode()
        elif number == _RAW and isinstance(value, bytes):
            raw = value
    if kind not in _TYPES or len(raw) != math.prod(shape) * _TYPES[kind].itemsize:
        return name, np.empty(0, np.float32)  # another kind of tensor, which no convolution has as weights
    return name, np.frombuffer(raw, _TYPES[kind]).reshape(shape)


def _packed(content: bytes) -> list[int]:
    values, at = [], 0
    while at < len(content):
        value, at = _varint(content, at)
        values.append(value)
    return values


def _strings(content: int | bytes) -> tuple[str, list[str], list[str]]:
    """(operation, inputs, outputs) of a node."""
    if not isinstance(content, bytes):
        raise ValueError("a node that is a number")
    found: dict[int, list[str]] = {_INPUT: [], _OUTPUT: [], _OPERATION: []}
    for number, value in _fields(content):
        if number in found and isinstance(value, bytes):
            found[number].append(value.decode())
    return (found[_OPERATION] or [""])[0], found[_INPUT], found[_OUTPUT]
