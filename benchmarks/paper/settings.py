"""Variants of the paper's descent: its three cases, which are shipped scenarios, and the same with our defaults."""

from __future__ import annotations

from typing import NamedTuple

from benchmarks.paper.sheets import DEFAULT, NONE, OURS_LONG, OURS_SHORT, PAPER_LONG, PAPER_SHORT

SCENARIO = "descent"
"""Scenario of the variants with this project's defaults."""

DEMO = "demo"
"""Scenario of the README's picture, which ``make sim`` runs; it has its own seed."""

SHORT_S, LONG_S = 2.5, 5.0
"""Horizons of the paper (s). The controller rounds them to whole stages of 0.3 s: 2.4 s and 5.1 s."""

COMPUTING_S = {SHORT_S: 0.40, LONG_S: 0.71}
"""Computing time (s) of one optimisation on the paper's machine, by horizon (s)."""

WITHOUT_CONTROL = "controller.lateral=false"


class Variant(NamedTuple):
    """Variant of the descent; a row of the tables."""

    key: str  # of the group of its runs
    name: str  # in the first column of the table
    scenario: str
    overrides: tuple[str, ...] = ()  # settings, TABLE.KEY=VALUE, that replace those of the scenario

    @property
    def lateral(self) -> bool:
        """True if the lateral thrusters are used."""
        return self.scenario != NONE and WITHOUT_CONTROL not in self.overrides


RECORDED = (
    Variant(NONE, "no control", NONE),
    Variant(PAPER_SHORT, "the paper's cost and delay", PAPER_SHORT),
    Variant(PAPER_LONG, "the paper's cost and delay", PAPER_LONG),
    Variant(OURS_SHORT, "this project's cost", SCENARIO, (f"controller.horizon_s={SHORT_S}",)),
    Variant(OURS_LONG, "this project's cost", SCENARIO, (f"controller.horizon_s={LONG_S}",)),
    Variant(DEFAULT, "this project's defaults", SCENARIO),
)
"""Variants that are recorded for the figures; each is one run."""

README = (
    Variant("demo-none", "no control", DEMO, (WITHOUT_CONTROL,)),
    *(Variant(f"demo-{s:g}s", f"horizon {s:g} s", DEMO, (f"controller.horizon_s={s}",)) for s in (SHORT_S, LONG_S)),
    Variant("demo", "default horizon", DEMO),
)
"""Variants of the demo in the README's picture. They differ in the horizon alone; the last one is the demo itself."""
