"""Settings of the paper's descents, as differences from the shipped scenario.

The paper's setting is its cost (positions alone), its two horizons and the computing time that it gives for each.
"""

from __future__ import annotations

from typing import NamedTuple

from services.reporting.figures.paper import NONE, OURS_LONG, OURS_SHORT, PAPER_LONG, PAPER_SHORT

SCENARIO = "descent"

SHORT_S, LONG_S = 2.5, 5.0
"""Horizons of the paper; in whole stages of 0.3 s they are 2.4 s and 5.1 s."""

COMPUTING_S = {SHORT_S: 0.40, LONG_S: 0.71}
"""Time of one optimisation on the paper's machine, by horizon."""

PAPER_COST = (
    "controller.weights.terminal_position_per_m2=0.0",
    "controller.weights.terminal_velocity_s2_per_m2=0.0",
)
"""Cost of positions only, and this project's small weights on thrust, without which the QP has no unique solution."""

KNOWN = ("run.perfect_state=true",)
"""Setting without localisation, which shows the controller alone."""


class Setting(NamedTuple):
    """Row of the tables: its settings on top of the scenario, and its name."""

    key: str
    name: str
    keys: tuple[str, ...]

    @property
    def lateral(self) -> bool:
        """Return True if the thrusters are used."""
        return self.key != NONE


def _setting(key: str, name: str, horizon_s: float, *, computing: bool, cost: tuple[str, ...] = ()) -> Setting:
    delay = (f"run.compute_delay_s={COMPUTING_S[horizon_s]}",) if computing else ()
    return Setting(key, name, (f"controller.horizon_s={horizon_s}", *delay, *cost))


RECORDED = (
    Setting(NONE, "no control", ("controller.lateral=false",)),
    _setting(PAPER_SHORT, "the paper's cost and delay", SHORT_S, computing=True, cost=PAPER_COST),
    _setting(PAPER_LONG, "the paper's cost and delay", LONG_S, computing=True, cost=PAPER_COST),
    _setting(OURS_SHORT, "ours", SHORT_S, computing=False),
    _setting(OURS_LONG, "ours", LONG_S, computing=False),
)
"""Runs of the figures."""

AVERAGED = (
    *RECORDED,
    _setting("ours-2.5s-late", "ours, the paper's delay", SHORT_S, computing=True),
    _setting("ours-5s-late", "ours, the paper's delay", LONG_S, computing=True),
)
"""Rows of the table over many seeds."""
