"""A store that is interrupted anywhere continues with what is missing, and refuses what is not its own."""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
import numpy.typing as npt
import pytest

from benchmarks.batch import as_plain, decode
from ltv_mpc.errors import ConfigError
from ltv_mpc.messages import Array
from services.tools.batch.results_store import NAME, open_store

SETTINGS = {"seed": 3, "design": {"kinds": ("a", "b"), "size": 0.1}, "version": "1"}


class Of(NamedTuple):
    t_ns: npt.NDArray[np.int64]
    error_m: Array
    outside: npt.NDArray[np.bool_]


class Figure(msgspec.Struct):
    ratio: float | None
    of: dict[str, Of]


def test_what_was_appended_comes_back_as_it_was(tmp_path: Path) -> None:
    """Arrays to the last bit and with their kind; an infinite figure too."""
    of = Of(np.array([2**53 + 1, 7]), np.array([[0.1, math.inf], [math.nan, -1e-300]]), np.array([True, False]))
    with open_store(tmp_path / "new", SETTINGS) as store:
        store.append("one", as_plain(Figure(math.inf, {"x": of})))
        store.append("two", [Figure(None, {}), Figure(0.1 + 0.2, {})])
    with open_store(tmp_path / "new", SETTINGS) as store:
        assert store.keys == {"one", "two"}
        found = dict(store.results())
    one = decode(found["one"], Figure)
    assert one.ratio == math.inf
    for a, b in zip(one.of["x"], of, strict=True):
        np.testing.assert_array_equal(a, b)
        assert a.dtype == b.dtype
    assert decode(found["two"], list[Figure]) == [Figure(None, {}), Figure(0.1 + 0.2, {})]


def test_a_file_that_is_cut_at_any_byte_keeps_every_whole_line(tmp_path: Path) -> None:
    with open_store(tmp_path, SETTINGS) as store:
        for key in ("a", "b"):
            store.append(key, {"x": key})
    path = tmp_path / NAME
    whole = path.read_bytes()
    ends = [i + 1 for i, byte in enumerate(whole) if byte == 10]
    for length in range(len(whole) + 1):
        path.write_bytes(whole[:length])
        with open_store(tmp_path, SETTINGS) as store:
            left = sum(length >= end for end in ends[1:])
            assert store.keys == set("ab"[:left])
            for key in "ab"[left:]:
                store.append(key, {"x": key})
        assert path.read_bytes() == whole


def test_another_process_is_refused_meanwhile(tmp_path: Path) -> None:
    refused = pytest.raises(ConfigError, match="another process")
    with open_store(tmp_path, SETTINGS), refused, open_store(tmp_path, SETTINGS):
        pass


def test_other_settings_are_refused_by_name_and_force_begins_again(tmp_path: Path) -> None:
    with open_store(tmp_path, SETTINGS) as store:
        store.append("a", 1)
    before = (tmp_path / NAME).read_bytes()
    other = {**SETTINGS, "design": {"kinds": ("a", "b"), "size": 0.2}, "version": "2"}
    problem = r"holds another campaign.*\(design.size = 0.1 there, 0.2 here; version = .1. there, .2. here\).*--force"
    with pytest.raises(ConfigError, match=problem), open_store(tmp_path, other):
        pass
    assert (tmp_path / NAME).read_bytes() == before
    with open_store(tmp_path, other, force=True) as store:
        assert store.keys == set()
    with open_store(tmp_path, other) as store:
        assert store.keys == set()


def test_a_line_that_is_damaged_is_named(tmp_path: Path) -> None:
    with open_store(tmp_path, SETTINGS) as store:
        store.append("a", 1)
    path = tmp_path / NAME
    path.write_bytes(path.read_bytes() + b"\0\0\n")
    with pytest.raises(ConfigError, match="line 3: is damaged"), open_store(tmp_path, SETTINGS):
        pass
    path.write_bytes(b"\0\n")
    with pytest.raises(ConfigError, match="cannot be read"), open_store(tmp_path, SETTINGS):
        pass
