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


def test_the_share_is_of_what_was_stored_since_and_never_more_than_all(cache: Path) -> None:
    write(cache / "ltv_mpc.control.cost" / "earlier.nbc", jit_cache.MACHINE_CODE_BYTES)  # of an earlier version
    before = jit_cache.stored_bytes()
    assert jit_cache.share(before) == 0.0
    write(cache / "ltv_mpc.control.cost" / "first.nbc", jit_cache.MACHINE_CODE_BYTES // 4)
    assert jit_cache.share(before) == 0.25
    write(cache / "sim.plant" / "second.nbc", jit_cache.MACHINE_CODE_BYTES)
    assert jit_cache.share(before) == 1.0


def test_an_edit_of_a_source_is_not_compiled_yet(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (cache / "ltv_mpc").mkdir()
    source = cache / "ltv_mpc" / "one.py"
    source.write_text("x = 1")
    monkeypatch.setattr(jit_cache.ltv_mpc, "__path__", [str(cache / "ltv_mpc")])
    jit_cache.mark().touch()
    assert jit_cache.is_warm()
    source.write_text("x = 2")
    assert not jit_cache.is_warm()


@pytest.mark.usefixtures("cache")
@pytest.mark.parametrize(("scenario", "warm"), [("no-such-scenario", False), ("descent", True)])
def test_the_cache_is_marked_where_every_part_is_compiled(scenario, warm, capfd, monkeypatch) -> None:
    """The part uses the real cache, which is full: the bar does not end at half."""
    for name in ("solver", "controller"):
        monkeypatch.delitem(jit_cache.PARTS, name)
    monkeypatch.setattr(jit_cache, "die_with_parent", lambda _: None)
    assert (jit_cache.main(["1", scenario]) == 0) == warm == jit_cache.is_warm()
    assert ("no-such-scenario" in capfd.readouterr().err) != warm
    assert sum(path.stat().st_size for path in CACHE.glob("*/*.nbc")) > 0.85 * jit_cache.MACHINE_CODE_BYTES
