"""How much is compiled, and when it is said to be all."""

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
def test_a_part_that_fails_leaves_the_cache_unmarked(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(jit_cache.sys, "argv", ["warm", "no-such-scenario"])
    assert jit_cache.main() != 0
    assert not jit_cache.is_warm()
    assert "no-such-scenario" in capfd.readouterr().err


def test_where_every_part_is_compiled_the_cache_is_marked(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The parts' own cache is the real one, and full."""
    monkeypatch.setattr(jit_cache.sys, "argv", ["warm", "descent"])
    assert jit_cache.main() == 0
    assert jit_cache.is_warm()
    assert int((cache / jit_cache.EXPECTED).read_text()) > 80


def test_what_a_run_compiles_is_most_of_what_is_expected() -> None:
    """Else the bar would stand at half when all is done."""
    found = {path.name.split("-")[0] for path in jit_cache.CACHE.rglob("*.nbi")}
    assert len(found) > 0.7 * int((jit_cache.CACHE / jit_cache.EXPECTED).read_text())
