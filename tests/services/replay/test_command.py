"""Command ``ltv-mpc replay``: exit codes, one object with --json, and the text of the first difference.

The tutorial shows what it prints of an identical replay and of one with other settings, which tests/docs compares.
"""

from __future__ import annotations

import json
from collections.abc import Iterable

import pytest

from services.cli.app import run as cli
from services.recording.reader import StoredMessage
from tests.services.replay.altered import Plain, rewritten


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
