"""[estimator]: assumptions of the filter about the water, and the rate of its estimates."""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

from ltv_mpc import config
from ltv_mpc.currents import check_cells

MAX_CELLS = 500
"""Each cell adds two states to the filter."""

MAX_SAVED_CELLS = 220
"""With more, the covariance would exceed a message: no state is saved, and a restarted filter begins again."""


class EstimatorConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of the localisation filter; those of the sensors are in the sensors file."""

    estimate_period_ns: Annotated[int, Meta(ge=10_000_000, le=10_000_000_000)] = 100_000_000
    current_sd_mps: Annotated[float, Meta(gt=0, le=5)] = 0.04  # prior of the Gauss-Markov profile
    current_mean_sd_mps: Annotated[float, Meta(ge=0, le=5)] = 0.1  # prior of the part that all depths share
    current_correlation_length_m: Annotated[float, Meta(gt=0, le=1000)] = 8.0
    current_change_mps_per_rts: Annotated[float, Meta(ge=0, le=1)] = 0.0  # slow random walk of each cell in time
    cell_m: Annotated[float, Meta(gt=0, le=100)] = 1.0
    deepest_m: Annotated[float, Meta(gt=0, le=2000)] = 70.0  # the cost grows with the square of the number of cells
    water_prior: str = ""  # a profile saved earlier, CSV with sd_mps and sd_common_mps; empty: the prior above
    # Change of the water since that profile, at each depth: an assumption, a quarter of current_sd_mps.
    water_prior_change_sd_mps: Annotated[float, Meta(ge=0, le=5)] = 0.01
    adapts_to_water: bool = True  # inflates the process noise of water that changes unexpectedly (``process_noise.py``)
    afloat_acceleration_sd_mps2: Annotated[float, Meta(ge=0, le=10)] = 0.005  # horizontal, during levelling
    gate_probability: Annotated[float, Meta(gt=0.5, lt=1)] = 0.999  # probability that a correct row passes the gate

    @classmethod
    def load(cls, path: str) -> EstimatorConfig:
        """Read a TOML file that holds the [estimator] table alone. Raises ``ConfigError``.

        Parameters
        ----------
        path : of the file, with a suffix or a slash.
        """
        settings = config.load(path, cls, what="estimator settings", package=None)
        check_cells(settings.deepest_m, settings.cell_m, MAX_CELLS, path, "cell_m")
        return settings

    @property
    def is_saved(self) -> bool:
        """True if the state of the filter fits a message."""
        return self.deepest_m / self.cell_m <= MAX_SAVED_CELLS
