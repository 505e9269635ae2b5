"""Command ``ltv-mpc replay``: exit codes, one object with --json, and the text of the first difference."""

from __future__ import annotations

import json
from collections.abc import Iterable

import pytest

from services.cli.app import run as cli
from services.recording.reader import StoredMessage
from tests.services.replay.altered import Plain, rewritten


def test_an_identical_replay_ends_with_0_and_reports_100_percent(locked_run, capsys) -> None:
    assert cli(["replay", str(locked_run.path)]) == 0
    out, err = capsys.readouterr()
    lines = {line[:13].strip(): line[14:] for line in out.splitlines() if line}
    assert lines["identical"].startswith("100 % of ")
    assert lines["run"] == "descent, 4.0 s in lock step"
    assert out.splitlines()[-1] == str(locked_run.recording)
    assert "first differs" not in out
    assert err == ""


def test_a_difference_ends_with_1_and_is_shown_field_by_field(recording, tmp_path, capsys) -> None:
    def damaged(stored: StoredMessage, plain: Plain) -> Iterable[Plain]:
        return [plain | {"north_m": 12.5}] if stored.key == "estimate" and plain["sequence"] == 7 else [plain]

    out = rewritten(recording, tmp_path / "run.mcap", damaged)
    assert cli(["replay", str(out), "--node", "estimator", "--json"]) == 1
    verdict = json.loads(capsys.readouterr().out)
    assert verdict["identical"] is False
    assert [field["path"] for field in verdict["first_difference"]["fields"]] == ["north_m"]
    assert cli(["replay", str(out), "--node", "estimator"]) == 1
    (where, field) = [line for line in capsys.readouterr().out.splitlines() if "differs" in line or "north_m" in line]
    assert where.startswith("first differs estimator, step ")
    assert where.endswith(": estimate 7")
    assert "recorded 12.5" in field
    assert f"replayed {verdict['first_difference']['fields'][0]['replayed']}" in field


def test_with_other_settings_it_says_what_would_have_changed(locked_run, tmp_path, capsys) -> None:
    settings = tmp_path / "mine.toml"
    settings.write_text("[weights]\nthrust = 0.3\n")
    assert cli(["replay", str(locked_run.path), "--with", str(settings)]) == 0
    out = capsys.readouterr().out
    assert "its controller with" in out
    assert "weights.thrust = 0.3, in the run 0.03" in out
    assert "port thrust" in out


@pytest.mark.parametrize(
    ("words", "wrong"),
    [
        (["{run}", "--with", "{run}/scenario.toml"], "its keys fit none of them"),
        (
            ["{run}", "--with", "{run}/config/controller.toml", "--node", "estimator"],
            "holds settings of the controller",
        ),
        (["{run}", "--node", "pilot"], "must be one of plant, sensors, estimator, controller"),
    ],
)
def test_bad_input_ends_with_2_and_one_line(locked_run, capsys, words, wrong) -> None:
    assert cli(["replay", *(word.format(run=locked_run.path) for word in words)]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert wrong in err
    assert len(err.splitlines()) == 1
