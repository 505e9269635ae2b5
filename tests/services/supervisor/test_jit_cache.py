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


def test_the_share_is_of_what_is_expected_and_never_more_than_all(cache: Path) -> None:
    (cache / "a").mkdir()
    (cache / "a" / "first.nbi").touch()
    assert jit_cache.share() == 0.0  # nobody has counted
    (cache / jit_cache.EXPECTED).write_text("4")
    assert jit_cache.share() == 0.25
    for name in "bcdef":
        (cache / f"{name}.nbi").touch()
    assert jit_cache.share() == 1.0


@pytest.mark.usefixtures("cache")
def test_a_part_that_fails_leaves_the_cache_unmarked(capfd: pytest.CaptureFixture[str]) -> None:
    assert jit_cache.main(["no-such-scenario"]) != 0
    assert not jit_cache.is_warm()
    assert "no-such-scenario" in capfd.readouterr().err


def test_where_every_part_is_compiled_the_cache_is_marked(cache: Path) -> None:
    """The parts use the real cache, which is full: most of what was expected, so that the bar does not end at half."""
    assert jit_cache.main(["descent"]) == 0
    assert jit_cache.is_warm()
    expected = int((cache / jit_cache.EXPECTED).read_text())
    assert (
        expected > 150
    )  # the functions of all processes: otherwise the bar would stay at its end for half of the time
    assert len(list(CACHE.rglob("*.nbi"))) > 0.85 * expected
