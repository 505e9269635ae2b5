"""Variants of the paper's descent, each as settings that override the shipped scenario.

The paper's variants have its cost (positions only), its two horizons, and the computing time that it states for each.
"""

from __future__ import annotations

from typing import NamedTuple

from services.reporting.figures.paper import DEFAULT, NONE, OURS_LONG, OURS_SHORT, PAPER_LONG, PAPER_SHORT

SCENARIO = "descent"

DEMO = "demo"
"""Scenario of the README's picture, which ``make sim`` runs; it has its own seed."""

SHORT_S, LONG_S = 2.5, 5.0
"""Horizons of the paper (s). The controller rounds them to whole stages of 0.3 s: 2.4 s and 5.1 s."""

COMPUTING_S = {SHORT_S: 0.40, LONG_S: 0.71}
"""Computing time (s) of one optimisation on the paper's machine, by horizon (s)."""

PAPER_COST = (
    "controller.weights.terminal_position_per_m2=0.0",
    "controller.weights.terminal_velocity_s2_per_m2=0.0",
)
"""Cost of the paper: no terminal terms. The small weights on thrust stay, because without them the QP has no unique
solution.
"""

EFFORT = "controller.effort=high"
"""Effort of the comparison: the error comes before the thrust, as in the paper, which has no weight on thrust."""

PERFECT_STATE = ("run.perfect_state=true",)
"""Override that replaces the localisation by the true state, to show the performance of the controller alone."""


WITHOUT_CONTROL = "controller.lateral=false"


class Variant(NamedTuple):
    """Variant of the descent; a row of the tables."""

    key: str  # of the group of its runs
    name: str  # in the first column of the table
    overrides: tuple[str, ...]  # settings, TABLE.KEY=VALUE, that replace those of the scenario

    @property
    def lateral(self) -> bool:
        """True if the lateral thrusters are used."""
        return WITHOUT_CONTROL not in self.overrides


def _variant(key: str, name: str, horizon_s: float, *, with_delay: bool, cost: tuple[str, ...] = ()) -> Variant:
    """Return a variant with control; ``with_delay`` simulates the computing time of the paper's machine."""
    delay = (f"run.compute_delay_s={COMPUTING_S[horizon_s]}",) if with_delay else ()
    return Variant(key, name, (f"controller.horizon_s={horizon_s}", EFFORT, *delay, *cost))


RECORDED = (
    Variant(NONE, "no control", (WITHOUT_CONTROL,)),
    _variant(PAPER_SHORT, "the paper's cost and delay", SHORT_S, with_delay=True, cost=PAPER_COST),
    _variant(PAPER_LONG, "the paper's cost and delay", LONG_S, with_delay=True, cost=PAPER_COST),
    _variant(OURS_SHORT, "this project's cost", SHORT_S, with_delay=False),
    _variant(OURS_LONG, "this project's cost", LONG_S, with_delay=False),
    Variant(DEFAULT, "this project's defaults", ()),
)
"""Variants that are recorded for the figures, with localisation; each is one run."""

README = (
    Variant("demo-none", "no control", (WITHOUT_CONTROL,)),
    *(Variant(f"demo-{s:g}s", f"horizon {s:g} s", (f"controller.horizon_s={s}",)) for s in (SHORT_S, LONG_S)),
    Variant("demo", "default horizon", ()),
)
"""Variants of the demo in the README's picture. They differ in the horizon alone; the last one is the demo itself."""

AVERAGED = (
    *RECORDED,
    _variant("ours-2.5s-late", "this project's cost, the paper's delay", SHORT_S, with_delay=True),
    _variant("ours-5s-late", "this project's cost, the paper's delay", LONG_S, with_delay=True),
)
"""Variants of the table over many seeds, with the true state."""
