"""Progress and completeness of the cache of compiled code."""

from __future__ import annotations

from pathlib import Path

import pytest

from ltv_mpc.jit import CACHE
from services.supervisor import jit_cache


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(jit_cache, "CACHE", tmp_path)
    return tmp_path


def write(path: Path, size: int) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as file:
        file.truncate(size)


def test_the_share_is_of_this_checkout_and_never_more_than_all(cache: Path) -> None:
    assert jit_cache.share() == 0.0
    write(cache / "control_1" / "first.nbc", jit_cache.MACHINE_CODE_BYTES // 4)
    write(cache / "ltv-mpc" / "2" / "control_3" / "first.nbc", jit_cache.MACHINE_CODE_BYTES)  # of another checkout
    assert jit_cache.share() == 0.25
    write(cache / "sim_1" / "second.nbc", jit_cache.MACHINE_CODE_BYTES)
    assert jit_cache.share() == 1.0


@pytest.mark.usefixtures("cache")
def test_a_part_that_fails_leaves_the_cache_unmarked(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("solver", "controller"):
        monkeypatch.delitem(jit_cache.PARTS, name)
    assert jit_cache.main(["no-such-scenario"]) != 0
    assert not jit_cache.is_warm()
    assert "no-such-scenario" in capfd.readouterr().err


@pytest.mark.usefixtures("cache")
def test_where_every_part_is_compiled_the_cache_is_marked() -> None:
    """The parts use the real cache, which is full: the bar does not end at half."""
    assert jit_cache.main(["descent"]) == 0
    assert jit_cache.is_warm()
    assert sum(path.stat().st_size for path in CACHE.glob("*/*.nbc")) > 0.85 * jit_cache.MACHINE_CODE_BYTES
