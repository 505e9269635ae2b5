"""Progress and completeness of the cache of compiled code."""

from __future__ import annotations

from pathlib import Path

import pytest

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
    """The parts use the real cache, which is full."""
    assert jit_cache.main(["descent"]) == 0
    assert jit_cache.is_warm()
    assert int((cache / jit_cache.EXPECTED).read_text()) > 150


def test_what_a_run_compiles_is_most_of_what_is_expected() -> None:
    """Otherwise the progress bar would end at half, or stay at its end for half of the time."""
    found = list(jit_cache.CACHE.rglob("*.nbi"))
    assert 0.85 < len(found) / int((jit_cache.CACHE / jit_cache.EXPECTED).read_text()) <= 1.0
