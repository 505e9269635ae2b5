"""What only the paper's Fig 3 has: how much the current differs between two depths, made up and measured."""

from __future__ import annotations

from collections.abc import Sequence

from services.reporting.plots import palette
from services.reporting.plots.description import Axis, Plot, Series, Style

MADE_UP = "made_up"
"""Table: ``lag_m``, ``low_m2ps2``, ``high_m2ps2`` of many seeds, and ``model_m2ps2`` of the model."""

LAG, MEAN_SQUARE = "lag_m", "square_m2ps2"
"""Columns of each measured profile's table, which has the profile's name."""


def structure(measured: Sequence[str]) -> Plot:
    """The structure function D(h) = mean (c(z + h) - c(z))^2 of one axis, for these measured profiles."""
    return Plot(
        name="structure",
        title="Structure function",
        x=Axis(label="difference in depth (m)", log=True),
        y=Axis(label="mean square difference (m²/s²)", log=True),
        over_time=False,
        note="Mean of north and east. Of the made-up profiles the band holds nine in ten seeds.",
        series=(
            Series(
                label="made up, 90 %",
                table=MADE_UP,
                x=LAG,
                y="low_m2ps2",
                y_high="high_m2ps2",
                colour=palette.REFERENCE,
                style=Style.BAND,
            ),
            Series(
                label="made up, model",
                table=MADE_UP,
                x=LAG,
                y="model_m2ps2",
                colour=palette.TRUTH,
                style=Style.DASHED,
            ),
            *(
                Series(label=name, table=name, x=LAG, y=MEAN_SQUARE, colour=palette.RUNS[i % len(palette.RUNS)])
                for i, name in enumerate(measured)
            ),
        ),
    )
