"""How noisy a recording's beams are, from the recording itself: four beams over three velocities leave one to spare.

    e = z_ahead + z_astern - z_starboard - z_port

sees no flow that is the same in all beams; with independent noise sd(e) = 2 sigma. sigma of cell j is taken from the
central 90 % of e over the dive (half its width / 1.645): outliers beyond are for the gate, a bias of e is not noise.
With fewer than 30 samples of a cell it is that of the cell before, of the first cell that of all cells together; with
fewer than 30 in all it is twice the data sheet's, which no cell's falls below:
    sigma = 1.94 cm/s (1200 kHz / f) (1 m / cell) / sqrt(pings)
(WorkHorse 1200 kHz, 1 m cells, at rest; the uncertainty of a ping goes with 1 / (bandwidth x pulse length)).
A cell whose share g of good pings is less has sigma / sqrt(g).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ltv_mpc.localisation.pd0.beams import BeamEnsemble
from ltv_mpc.localisation.pd0.records import Settings
from ltv_mpc.messages import Array

MIN_SAMPLES = 30
NOISE_AT_SEA = 2.0
"""Of the data sheet's noise, where nothing better is known: a vehicle moves while it pings."""
_OPPOSED = np.array([1.0, 1.0, -1.0, -1.0])


def data_sheet_sd(settings: Settings) -> float:
    """sigma of one beam and ensemble (m/s), all pings good."""
    return 0.0194 * (1200 / settings.frequency_kHz) / settings.cell_m / float(np.sqrt(settings.pings))


def beam_sd(ensembles: Sequence[BeamEnsemble], settings: Settings, min_good_share: float) -> Array:
    """sigma of one beam (m/s) by cell, (cells,)."""
    sheet = data_sheet_sd(settings)
    spare = np.array([_OPPOSED @ x.velocity_mps for x in ensembles])
    spare[np.array([x.good[0] < min_good_share for x in ensembles])] = np.nan
    cells = [column[np.isfinite(column)] for column in spare.T]
    centred = [e - np.median(e) for e in cells if len(e)]
    everywhere = _sd(np.concatenate(centred)) if centred else None
    before = NOISE_AT_SEA * sheet if everywhere is None else everywhere
    sd = np.empty(settings.cells)
    for j, e in enumerate(cells):
        found = _sd(e)
        before = before if found is None else found
        sd[j] = max(before, sheet)
    return sd


def _sd(e: Array) -> float | None:
    """sigma of one beam from samples of e; None where there are too few."""
    if len(e) < MIN_SAMPLES:
        return None
    return float(np.quantile(np.abs(e - np.median(e)), 0.9)) / 1.645 / 2
