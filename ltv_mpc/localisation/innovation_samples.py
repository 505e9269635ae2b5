"""Innovations for the report of the filter: of each sensor a few of the newest message, in the unit of the measurement.

The mean NIS of ``health.py`` shows whether innovations have the size that the filter expects. Their values also show a
bias, and which sensor noise is wrong in metres, m/s or radians.
"""

from __future__ import annotations

import numpy as np

from ltv_mpc.localisation.filter.error_state_filter import Innovations
from ltv_mpc.messages import InnovationSample

MAX_ROWS = 4
"""Maximum number of innovations of one message: of a profiler about one a beam. It has 56 of them, and most say the
same, because they share the error of the vehicle."""


class InnovationSamples:
    """Store of the newest innovations of each sensor since the last report."""

    def __init__(self) -> None:
        self._newest: dict[tuple[str, int], InnovationSample] = {}

    def observe(self, innovations: Innovations) -> None:
        """Store those innovations of one message that passed the gate, at most ``MAX_ROWS`` at equal steps.

        Parameters
        ----------
        innovations : of one message, before the gate.
        """
        accepted = np.flatnonzero(innovations.accepted)
        if not len(accepted):
            return
        shown = accepted[:: -(-len(accepted) // MAX_ROWS)]
        # A message with a single row may come from one of several transponders, which its index names.
        source = int(innovations.indices[0]) if len(innovations.residual) == 1 else 0
        self._newest[innovations.sensor, source] = InnovationSample(
            sensor=innovations.sensor,
            t_ns=innovations.t_ns,
            rows=tuple(innovations.indices[shown].tolist()),
            innovations=tuple(innovations.residual[shown].tolist()),
            sd=tuple(np.sqrt(innovations.S[shown, shown]).tolist()),
        )

    def take(self) -> tuple[InnovationSample, ...]:
        """Return what was stored since the last call, in order of the first message of each sensor."""
        samples = tuple(self._newest.values())
        self._newest.clear()
        return samples
