"""Summary of the map: docs/horizon.json, and the tables of docs/horizon.md."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.horizon_map import rules
from benchmarks.horizon_map.places import GROUPS, Place, in_own_time, relative, thirds
from benchmarks.page_tables import Table
from ltv_mpc.control.horizon_selection import MIN_TIME_SCALES

RULES = {
    "H / T enough at nine of ten": "as many T as are enough at nine of ten places",
    "vehicle check": "what `vehicle check` proposes",
    "best H / T": "the best H / T",
    "best H": "the best H, for all vehicles",
    "four groups": "log(H / T) linear in the four groups",
    "5 s": "5 s",
}
"""Rules by name, with their text on the page."""


def summary(of: Sequence[Place]) -> dict[str, Any]:
    """Return the summary of one campaign."""
    horizons = of[0].horizons_s
    errors, times = relative(of), in_own_time(of)
    enough = np.array([place.horizons_s[place.enough] for place in of])
    return {
        "places": len(of),
        "proposed_over_T": MIN_TIME_SCALES,
        "horizons_s": horizons.tolist(),
        "enough": {str(h): int(sum(place.enough == i for place in of)) for i, h in enumerate(horizons)},
        "error_over_best": {
            str(h): {"median": float(np.median(errors[:, i])), "p90": float(np.quantile(errors[:, i], 0.9))}
            for i, h in enumerate(horizons)
        },
        "enough_over_T": {str(q): float(np.quantile(times, q)) for q in (0.1, 0.5, 0.9)},
        "rule": dict(zip(("a0", *GROUPS), rules.fitted(of).tolist(), strict=True)),
        "best_constant_H_s": rules.best_H_s(of),
        "best_constant_H_over_T": rules.best_ratio(of),
        "excess_at_places_not_fitted_to": rules.judged(of),
        "enough_s_by_third": {g: [float(np.median(enough[part])) for part in thirds(of, g)] for g in GROUPS},
    }


def tables(kept: Mapping[str, Mapping[str, Any]]) -> list[Table]:
    """Return the tables of the page, from the summaries by campaign."""
    horizons = next(iter(kept.values()))["horizons_s"]
    head = ("", *(f"{h:g} s" for h in horizons))
    plain = (0,) * len(head)

    def by_horizon(name: str, cell: str, of: str) -> Table:
        rows = ((label, *(cell.format(one[of][str(h)]) for h in horizons)) for label, one in kept.items())
        return Table(name=name, head=head, digits=plain, rows=tuple(rows))

    def by_campaign(name: str, first: str, rows: Mapping[str, Sequence[str]]) -> Table:
        return Table(
            name=name,
            head=(first, *kept),
            digits=(0,) * (1 + len(kept)),
            rows=tuple((label, *cells) for label, cells in rows.items()),
        )

    return [
        by_campaign("flown", "", {"places": [str(one["places"]) for one in kept.values()]}),
        by_horizon("errors", "{0[median]:.2f}, {0[p90]:.2f}", "error_over_best"),
        by_horizon("enough", "{0}", "enough"),
        by_campaign(
            "own time",
            "H / T that is enough at",
            {
                label: [f"{one['enough_over_T'][q]:.1f}" for one in kept.values()]
                for label, q in (("one of ten places", "0.1"), ("half of them", "0.5"), ("nine of ten", "0.9"))
            },
        ),
        by_campaign(
            "thirds",
            "group",
            {g: [", ".join(f"{x:g}" for x in one["enough_s_by_third"][g]) for one in kept.values()] for g in GROUPS},
        ),
        by_campaign(
            "rules",
            "",
            {
                label: [
                    "{median:.0%}, {p90:.0%}, {worst:.0%}".format(**one["excess_at_places_not_fitted_to"][name])
                    for one in kept.values()
                ]
                for name, label in RULES.items()
            },
        ),
    ]
