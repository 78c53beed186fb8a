"""The restricted unpickler: reads what public datasets hold, as Python does, and runs nothing."""

from __future__ import annotations

import io
import os
import pickle
from collections import OrderedDict
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from freetalk.data.safe_pickle import UnsafePickleError, load_pickle, read_pickle

VALUES: dict[str, Any] = {
    "nested": {
        "FaceTalk_1": {"sentence01": {"audio": np.arange(40, dtype=np.int16), "rate": 22000}}
    },
    "fortran": np.asfortranarray(np.ones((2, 3))),
    "strided": np.arange(24.0).reshape(2, 3, 4).transpose(0, 2, 1),
    "big_endian": np.arange(3, dtype=">i2"),
    "half": np.float16([1, 2]),
    "scalars": [np.float32(3), np.bool_(True), np.int64(-4), 1 + 2j, None, True, 2**70],
    "text": [np.array(["ab", "c"]), np.array([b"a", b"bcd"]), "caf\u00e9", b"", b"\x00\xff"],
    "objects": np.array([{"inner": np.zeros(2)}, None, "x"], dtype=object),
    "containers": [OrderedDict(a=1), {1, 2}, frozenset({3}), bytearray(b"xy"), (1, (2,))],
    "empty": [np.zeros((0, 3)), np.array(5.0), {}, [], ()],
}


def assert_equal(expected: Any, found: Any) -> None:
    assert type(found) is type(expected)
    if isinstance(expected, np.ndarray):
        assert found.dtype == expected.dtype
        if expected.dtype == object:
            assert_equal(expected.tolist(), found.tolist())
        else:
            np.testing.assert_array_equal(found, expected)
    elif isinstance(expected, dict):
        assert list(found) == list(expected)
        for key in expected:
            assert_equal(expected[key], found[key])
    elif isinstance(expected, list | tuple):
        assert len(found) == len(expected)
        for one, other in zip(expected, found):
            assert_equal(one, other)
    else:
        assert found == expected


@pytest.mark.parametrize("name", VALUES)
@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
def test_arrays_and_containers_are_read_as_python_reads_them(name: str, protocol: int) -> None:
    data = pickle.dumps(VALUES[name], protocol=protocol)
    assert_equal(pickle.loads(data), read_pickle(io.BytesIO(data), "file"))


@pytest.mark.parametrize("module", [b"numpy.core", b"numpy._core"])
def test_module_paths_of_numpy_1_and_2_are_known(module: bytes) -> None:
    data = pickle.dumps(np.arange(5.0), protocol=2)
    other = data.replace(b"numpy._core", module).replace(b"numpy.core", module)
    np.testing.assert_array_equal(read_pickle(io.BytesIO(other), "file"), np.arange(5.0))


def test_python_2_pickles_of_arrays_are_read(tmp_path: Path) -> None:
    # What Python 2's pickle.dump(.., protocol 0) writes for {"a": np.array([1, 2], "<f4")}.
    (tmp_path / "old.pkl").write_bytes(
        b"(dp0\nS'a'\np1\ncnumpy.core.multiarray\n_reconstruct\np2\n(cnumpy\nndarray\np3\n(I0\n"
        b"tp4\nS'b'\np5\ntp6\nRp7\n(I1\n(I2\ntp8\ncnumpy\ndtype\np9\n(S'f4'\np10\nI0\nI1\ntp11\n"
        b"Rp12\n(I3\nS'<'\np13\nNNNI-1\nI-1\nI0\ntp14\nbI00\n"
        b"S'\\x00\\x00\\x80?\\x00\\x00\\x00@'\np15\ntp16\nbs."
    )
    np.testing.assert_array_equal(load_pickle(tmp_path / "old.pkl")["a"], np.float32([1, 2]))


class _Command:
    def __init__(self, target: Path) -> None:
        self.target = target

    def __reduce__(self) -> tuple[Any, ...]:
        return os.mkdir, (str(self.target),)


def test_a_forbidden_function_is_named_and_never_called(tmp_path: Path) -> None:
    bad = tmp_path / "templates.pkl"
    bad.write_bytes(pickle.dumps({"a": [np.zeros(3), _Command(tmp_path / "made")]}))
    with pytest.raises(UnsafePickleError, match=r"templates\.pkl is no plain pickle.*posix\.mkdir"):
        load_pickle(bad)
    assert not (tmp_path / "made").exists()


@pytest.mark.parametrize(
    ("value", "named"),
    [
        (np.random.RandomState(0), "numpy.random"),
        (np.array([(1, 2.0)], dtype=[("a", "i4"), ("b", "f4")]), "'V8'"),
        (np.ma.zeros(3), "numpy.ma"),
        (np.float64, "numpy.float64"),
        (Path("x"), "pathlib"),
        (getattr, "builtins.getattr"),
        ([np.ndarray], "a class or a function"),
    ],
)
def test_other_classes_are_refused(value: Any, named: str) -> None:
    with pytest.raises(UnsafePickleError) as refused:
        read_pickle(io.BytesIO(pickle.dumps(value)), "file")
    assert named in str(refused.value)


@pytest.mark.parametrize(
    "program",
    [
        b"cnumpy\nndarray\n(I2\nI3\nItR.",  # an array from arguments, past any check of its type
        b"cnumpy\ndtype\n}(S'_make'\nI1\nub.",  # what a name stands for is changed
        b"cnumpy\ndtype\n(S'O'\ntR(I3\nS'|'\nN(S'a'\nt}I8\nI1\nI63\ntb.",  # a crafted structured type
        b"cnumpy.core.multiarray\nscalar\n(cnumpy\ndtype\n(S'O'\ntRS'01234567'\ntR.",  # a pointer
        b"Pexternal\n.",
    ],
)
def test_crafted_programs_are_refused(program: bytes) -> None:
    with pytest.raises(ValueError, match="file is no"):
        read_pickle(io.BytesIO(program), "file")


def test_a_pickle_cut_short_is_named(tmp_path: Path) -> None:
    data = pickle.dumps(VALUES["nested"])
    for length in (0, 10, len(data) // 2, len(data) - 1):
        (tmp_path / "cut.pkl").write_bytes(data[:length])
        with pytest.raises(ValueError, match=r"cut\.pkl is no readable pickle.*cut short"):
            load_pickle(tmp_path / "cut.pkl")
    with pytest.raises(FileNotFoundError, match=r"none\.pkl"):
        load_pickle(tmp_path / "none.pkl")
