"""Reads the pickles of public datasets without running what they say.

A pickle is a program that may name any function. Here it may name a dozen: those that make numpy
arrays, numpy numbers and plain containers, each replaced by a checked one of our own, so that not
even numpy's own decoding of a crafted data type is reached.
"""

from __future__ import annotations

import pickle
import re
from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

import numpy as np
import numpy.typing as npt

_DTYPE = re.compile(r"(\?|b1|[iu][1248]|f[248]|c8|c16|O8?|[SU]\d{1,9})\Z")
_BYTE_ORDERS = ("<", ">", "|", "=")


class UnsafePickleError(ValueError):
    """A pickle asks for something else than arrays and plain containers."""


def load_pickle(path: str | Path) -> Any:
    """Reads a pickle of numpy arrays, numbers, strings and plain containers.

    Files of Python 2 are read with latin1 strings; module paths of numpy 1 and 2 are both known.

    Args:
        path: the file.

    Returns:
        The object; arrays are plain ``numpy.ndarray``.

    Raises:
        FileNotFoundError: no such file.
        UnsafePickleError: the file names a class or function outside the list, or an array of
            structured or unknown type; the message names the file and what was asked for.
        ValueError: the file is no pickle, or is cut short.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"there is no file {path}")
    with path.open("rb") as file:
        return read_pickle(file, str(path))


def read_pickle(file: IO[bytes], name: str) -> Any:
    """As :func:`load_pickle`, of an open binary file that messages call ``name``."""
    try:
        return _plain(_Unpickler(file, encoding="latin1").load(), {})
    except UnsafePickleError as error:
        raise UnsafePickleError(
            f"{name} is no plain pickle: {error}; only numpy arrays, numbers, strings and plain "
            "containers are read, because anything else could run code on this machine"
        ) from None
    except MemoryError:
        raise
    except RecursionError:
        raise ValueError(f"{name} is nested too deeply to be a dataset") from None
    except Exception as error:  # a damaged pickle raises nearly anything
        raise ValueError(
            f"{name} is no readable pickle ({type(error).__name__}: {error}); it may be cut short: "
            "compare its size with the published one and fetch it again"
        ) from error


class _DType:
    """Stands for ``numpy.dtype`` while loading: a simple type, then perhaps its byte order."""

    def __init__(self, code: object, *_: object) -> None:
        if not isinstance(code, str) or not _DTYPE.match(code):
            raise UnsafePickleError(f"it holds an array of type {code!r}")
        self.value: np.dtype[Any] = np.dtype(code)

    def __setstate__(self, state: object) -> None:
        if not isinstance(state, tuple) or len(state) < 5 or any(s is not None for s in state[2:5]):
            raise UnsafePickleError(f"it holds an array of a structured type {state!r}")
        if state[1] not in _BYTE_ORDERS:
            raise UnsafePickleError(f"it holds an array of byte order {state[1]!r}")
        if state[1] in ("<", ">"):
            self.value = self.value.newbyteorder(state[1])


class _Array(np.ndarray):  # type: ignore[type-arg]
    """Stands for ``numpy.ndarray`` while loading, so that its type is checked before it is filled."""

    def __setstate__(self, state: Any) -> None:
        if not isinstance(state, tuple) or len(state) not in (4, 5):
            raise UnsafePickleError("it holds an array without a known state")
        version = state[:-4] or (1,)
        shape, dtype, fortran, data = state[-4:]
        if not isinstance(dtype, _DType):
            raise UnsafePickleError(f"it holds an array of type {type(dtype).__name__}")
        super().__setstate__((*version, shape, dtype.value, fortran, data))


def _make_array(kind: object, shape: object, code: object) -> _Array:
    """``numpy.core.multiarray._reconstruct``: an empty array that a state then fills."""
    if kind is not _NDARRAY:
        raise UnsafePickleError(f"it holds an array of class {type(kind).__name__}")
    return _Array.__new__(_Array, (0,), np.dtype("b"))


def _make_array_of_bytes(
    data: object, dtype: object, shape: object, order: object, axes: object = None
) -> npt.NDArray[Any]:
    """``numpy.core.numeric._frombuffer``: an array of protocol 5."""
    if not isinstance(dtype, _DType) or dtype.value.hasobject:
        raise UnsafePickleError("it holds an array of objects made of bytes")
    if not isinstance(data, bytes | bytearray) or not isinstance(shape, tuple):
        raise UnsafePickleError("it holds an array whose numbers are not in the file")
    flat = np.frombuffer(data, dtype=dtype.value)
    if order == "K" and isinstance(axes, tuple | list):
        return flat.reshape(shape, order="C").transpose(tuple(int(a) for a in axes))
    if order not in ("C", "F"):
        raise UnsafePickleError(f"it holds an array of axis order {order!r}")
    return flat.reshape(shape, order="F" if order == "F" else "C")


def _make_number(dtype: object, data: object = b"") -> Any:
    """``numpy.core.multiarray.scalar``: one number of a numpy type."""
    if not isinstance(dtype, _DType) or dtype.value.hasobject:
        raise UnsafePickleError("it holds a numpy scalar that is no number")
    raw = data.encode("latin1") if isinstance(data, str) else data
    if not isinstance(raw, bytes):
        raise UnsafePickleError("it holds a numpy scalar without bytes")
    return np.frombuffer(raw, dtype=dtype.value, count=1)[0]


def _encode(text: object, encoding: object = "latin1") -> bytes:
    """``_codecs.encode``: how old protocols store bytes."""
    if not isinstance(text, str) or encoding not in ("latin1", "latin-1"):
        raise UnsafePickleError(f"it encodes text as {encoding!r}")
    return text.encode("latin1")


def _make_bytearray(data: object = b"", encoding: object = "latin1") -> bytearray:
    if isinstance(data, str):
        data = _encode(data, encoding)
    if not isinstance(data, bytes):
        raise UnsafePickleError("it makes a bytearray of something else than bytes")
    return bytearray(data)


class _Maker:
    """What a name in a pickle stands for: can be called, and nothing else."""

    __slots__ = ("_make",)

    def __init__(self, make: Callable[..., Any]) -> None:
        self._make = make

    def __call__(self, *arguments: Any) -> Any:
        return self._make(*arguments)

    def __setstate__(self, state: object) -> None:
        raise UnsafePickleError("it changes what a name stands for")


def _refuse_array(*_: object) -> None:
    raise UnsafePickleError("it holds an array made from arguments")


_NDARRAY = _Maker(_refuse_array)
_NUMPY_MODULES = ("numpy.core", "numpy._core")
_ADMITTED: dict[tuple[str, str], _Maker] = {
    ("numpy", "ndarray"): _NDARRAY,
    ("numpy", "dtype"): _Maker(_DType),
    **{(f"{m}.multiarray", "_reconstruct"): _Maker(_make_array) for m in _NUMPY_MODULES},
    **{(f"{m}.multiarray", "scalar"): _Maker(_make_number) for m in _NUMPY_MODULES},
    **{(f"{m}.numeric", "_frombuffer"): _Maker(_make_array_of_bytes) for m in _NUMPY_MODULES},
    ("_codecs", "encode"): _Maker(_encode),
    ("collections", "OrderedDict"): _Maker(OrderedDict),
    ("builtins", "set"): _Maker(set),
    ("builtins", "frozenset"): _Maker(frozenset),
    ("builtins", "bytes"): _Maker(lambda: b""),  # old protocols store other bytes encoded
    ("builtins", "bytearray"): _Maker(_make_bytearray),
    ("builtins", "complex"): _Maker(complex),
}


class _Unpickler(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        # The base class renames the modules of Python 2 only when it imports; here nothing is.
        module = {"__builtin__": "builtins"}.get(module, module)
        if (module, name) not in _ADMITTED:
            raise UnsafePickleError(f"it asks for {module}.{name}")
        return _ADMITTED[module, name]

    def persistent_load(self, pid: object) -> Any:
        raise UnsafePickleError(f"it refers to an object outside the file, {pid!r}")


def _plain(value: Any, done: dict[int, Any]) -> Any:
    """The value with stand-ins replaced; containers that can change are changed in place."""
    if isinstance(value, _Array):
        if id(value) not in done:
            done[id(value)] = (value, value.view(np.ndarray))
            plain = done[id(value)][1]
            if plain.dtype.hasobject:
                flat = plain.reshape(-1)
                flat[:] = _objects([_plain(item, done) for item in flat])
        return done[id(value)][1]
    if isinstance(value, _DType):
        return value.value
    if isinstance(value, dict | list):
        if id(value) in done:
            return value
        done[id(value)] = (value, value)
        for key, item in list(value.items() if isinstance(value, dict) else enumerate(value)):
            value[key] = _plain(item, done)
        return value
    if isinstance(value, tuple):
        return tuple(_plain(item, done) for item in value)
    if isinstance(value, _Maker):
        raise UnsafePickleError("it stores a class or a function as a value")
    return value


def _objects(items: list[Any]) -> npt.NDArray[np.object_]:
    filled = np.empty(len(items), dtype=object)
    for index, item in enumerate(items):
        filled[index] = item
    return filled
