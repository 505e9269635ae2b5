"""Tutorials: each shown line is one that the commands above it print.

The commands run in the page's order and one folder. What runs in lock step is the same on every machine, so that its
numbers are compared too. Of the demo, which the reader runs as processes, a summary with known figures is formatted,
and a short run in lock step takes its place. tests/examples/test_python_publisher.py has the terminals of step 4, and
``python -m benchmarks.tutorials`` runs all of it as the reader does.
"""

from __future__ import annotations

import runpy
from collections import deque
from pathlib import Path
from typing import Any

import pytest

from services.cli.app import run
from services.reporting.run_summary_text import verdict
from tests.docs.page_reader import SEVERAL_TERMINALS, PageReader, printed_lines, take_shown
from tests.docs.pages import Block, Command, blocks
from tests.services.reporting.test_run_summary_text import SUMMARY

TUTORIALS = ("docs/tutorial.md", "docs/tutorial-vehicle.md")
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

DEMO_LINES = printed_lines(verdict(DEMO, Path("runs/demo")), exact=False)
IN_LOCK_STEP = ("sim", "--lockstep", "--surface-time-s", "2", "--duration-s", "5", "--seed", "1")


class Session(PageReader):
    """Reader that runs each command in this process."""

    def __init__(self, folder: Path, captured: pytest.CaptureFixture[str]) -> None:
        super().__init__(folder)
        self._captured = captured
        self._exact = True

    def run(self, command: Command, code: int = 0) -> None:
        """Run a command."""
        demo = command.words[:2] == ("make", "sim")
        if demo:
            assert run(list(IN_LOCK_STEP)) == 0
        elif command.ltv_mpc is not None:
            assert run(list(command.ltv_mpc)) == code, command.place
        else:
            runpy.run_path(str(self._folder / command.words[1]))
        output = self._captured.readouterr()
        if demo or "--lockstep" in command.words:
            self._exact = not demo  # the reader's demo is longer, and as processes
        self.printed += DEMO_LINES if demo else printed_lines(output.err + output.out, exact=self._exact)

    def run_side_by_side(self, block: Block) -> None:
        """Run nothing."""


@pytest.mark.timeout(900)
@pytest.mark.usefixtures("without_report")
@pytest.mark.parametrize("page", TUTORIALS)
def test_each_shown_line_is_printed_by_the_commands_above_it(page, tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    session, side_by_side = Session(tmp_path, capsys), False
    last = max(i for i, block in enumerate(blocks(page)) if block.language == "text")
    for block in blocks(page)[: last + 1]:  # what comes after it shows nothing; test_blocks.py runs its commands
        if block.language != "text":
            side_by_side = SEVERAL_TERMINALS in block.text
        if block.language != "text" or not side_by_side:
            session.read(block)


def test_each_line_of_a_summary_in_the_readme_has_the_shape_of_a_printed_one() -> None:
    (shown,) = (block for block in blocks("README.md") if block.language == "text")
    assert take_shown(shown.text, deque(DEMO_LINES)) is None
