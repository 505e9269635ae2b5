"""Structure functions of the water current (Fig 3 of the paper): synthetic and measured profiles."""

from __future__ import annotations

from collections.abc import Sequence

from services.reporting.plots import palette
from services.reporting.plots.description import Axis, Plot, Series, Style

SYNTHETIC = "synthetic"
"""Table with ``lag_m``, ``low_m2ps2`` and ``high_m2ps2`` of many seeds, and ``model_m2ps2`` of the model."""

LAG, MEAN_SQUARE = "lag_m", "square_m2ps2"
"""Columns of the table of each measured profile; the table has the name of the profile."""


def structure(measured: Sequence[str]) -> Plot:
    """Return the plot of the structure function D(h) = mean (c(z + h) - c(z))^2 of one axis."""
    return Plot(
        name="structure",
        title="Structure function",
        x=Axis(label="difference in depth (m)", log=True),
        y=Axis(label="mean square difference (m²/s²)", log=True),
        note="Mean of north and east. The band holds 90 % of the synthetic profiles.",
        series=(
            Series(
                label="synthetic, 90 %",
                table=SYNTHETIC,
                x=LAG,
                y="low_m2ps2",
                y_high="high_m2ps2",
                colour=palette.REFERENCE,
                style=Style.BAND,
            ),
            Series(
                label="synthetic, model",
                table=SYNTHETIC,
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
