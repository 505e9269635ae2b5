"""Outputs that the tutorials show have the shape of those that their commands print: only numbers may differ."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from services.cli.app import run
from services.reporting.run_summary_text import verdict
from tests.docs.pages import ROOT, blocks
from tests.services.reporting.test_run_summary_text import SUMMARY

PAGES = ("README.md", "docs/tutorial.md", "docs/tutorial-vehicle.md")
NUMBER = re.compile(r"-?\d+(\.\d+)?")
SPREAD = dict.fromkeys(("mean", "max", "final", "median", "p99"), 0.1)
THRUST = {
    **dict.fromkeys(("mean_abs_N", "max_abs_N", "max_slew_N_per_s", "propulsive_energy_J", "lateral_energy_J"), 1.0),
    **{"saturated_fraction": 0.0, "relative_power": 0.1},
}
DEMO: dict[str, Any] = {
    **SUMMARY,
    **{name: SPREAD for name, value in SUMMARY.items() if name.endswith(("_error_m", "_delay_s", "_delay_wall_s"))},
    **{"scenario": "demo", "speed_reached": 6.6, "tracking_error_m": dict.fromkeys(SPREAD, 0.02), "thrust": THRUST},
    **{"cycles": 9, "plan_origin": {"solved": 8, "zero": 1}, "deadline_misses": 1},
}
"""Summary of a run as processes in which each figure is known."""

PUBLISHER = ("# m north, # m east, disarmed", "# m north, # m east, controller")


def shape(text: str) -> str:
    """Return a text with # for each number and one space for several, as for a line break."""
    return " ".join(NUMBER.sub("#", text).split())


@pytest.fixture(scope="module")
def printed(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Return the shape of all that the commands of the tutorials print."""
    folder = tmp_path_factory.mktemp("tutorial")
    (boat,) = (one.text for one in blocks("docs/tutorial-vehicle.md") if one.language == "toml")
    (folder / "my_boat.toml").write_text(boat)
    (folder / "my_auv.toml").write_text(boat.replace("max_N = 119.7", "max_N = -30", 1))
    options = ["--lockstep", "--perfect-state", "--surface-time-s", "1", "--duration-s", "2", "--out", "boat"]
    output = []
    with pytest.MonkeyPatch.context() as patched:
        patched.chdir(folder)
        patched.setattr("typer.echo", lambda text="", **_: output.append(str(text)))
        assert run(["vehicle", "check", "my_boat.toml"]) == 0
        assert run(["vehicle", "check", "my_auv.toml"]) == 2
        assert run(["sim", "hover", *options, "--vehicle", "my_boat.toml", "--reference", "square"]) == 0
    return shape(" ".join((*output, *PUBLISHER, verdict(DEMO, Path("runs/demo")))))


@pytest.mark.parametrize("page", PAGES)
def test_each_shown_line_has_the_shape_of_a_printed_one(page: str, printed: str) -> None:
    shown = [line for block in blocks(page) if block.language == "text" for line in block.text.splitlines() if line]
    assert len(shown) > 2
    paragraph = re.compile(r"^[A-Z]|^[a-z\d].*\.$")  # sentences break where their numbers let them
    for line in shown:
        if not paragraph.match(line):
            assert shape(line) in printed, f"{page}: {line}"


def test_each_picture_of_a_tutorial_is_there() -> None:
    for page in PAGES:
        for name in re.findall(r"!\[[^]]+\]\(([^)]+)\)", (ROOT / page).read_text()):
            assert (ROOT / page).parent.joinpath(name).is_file(), name
