"""Weak thruster: which lateral thruster delivers less than it reports, and the share that it still delivers.

The thrust loss detector gives evidence, and the most likely lost share of each thruster. A loss belongs to one thruster
if it explains the evidence as well as a loss of both (``thrust_loss_detector.py``). The controller plans with the
share that is left until the loss has ended, by a cumulative sum test (Page 1954) of the log-likelihood ratios of no
loss against the loss in force. A thruster that is not used gives no evidence, and stays as it is.

The share has steps of ``STEP``, so that it does not follow the noise of its estimate, and is at least ``MIN_SHARE``: a
thruster that is not used at all could never show that it has recovered.
"""

from __future__ import annotations

from typing import TypeAlias

from ltv_mpc.messages import Health, Pair
from ltv_mpc.safety.health import NOMINAL, HealthState
from ltv_mpc.vehicle.parameters import Vehicle

MIN_LOSS = 0.2
"""Smallest lost share that is acted on: 10 % of mismatch are none, and a smaller loss costs the controller little."""

CONFIRMING_CYCLES = 3
"""Successive cycles that attribute a loss to the same thruster before it counts as weak."""

RECOVERY_NATS, LEAST_NS = 12.0, 10_000_000_000
"""Cumulative sum that ends a loss, and the least time for which one lasts: a box that comes and goes costs more than
a small one.
"""

STEP, HYSTERESIS = 0.1, 0.07
"""Steps of the share, and the distance from the share in force from which the nearest step replaces it."""

MIN_SHARE = 0.2
"""Smallest share."""

SIDES = "port", "starboard"


Attribution: TypeAlias = tuple[int, float]
"""Loss of thrust that the detector attributes to one thruster: 0 port or 1 starboard, and its lost share."""


def attribute(loss: Pair) -> Attribution | None:
    """Return the one thruster that a loss belongs to; None if it is small, or belongs to both.

    Parameters
    ----------
    loss : lost shares of port and starboard; that of a sound thruster is at most the mismatch of the model.
    """
    side = 0 if loss[0] > loss[1] else 1
    return (side, loss[side]) if loss[side] >= MIN_LOSS and loss[1 - side] < MIN_LOSS else None


class WeakThruster:
    """State of the lateral thrusters of one vehicle: sound, or one of them weak."""

    def __init__(self) -> None:
        self.shares: Pair = (1.0, 1.0)
        """Share of the reported thrust that port and starboard deliver."""
        self._side: int | None = None  # the weak one, or the one that may be
        self._confirmations = 0
        self._recovery = 0.0  # cumulative sum (nats)
        self._since_ns = 0  # start of the loss

    @property
    def is_weak(self) -> bool:
        """True if one thruster is weak."""
        return self.shares != (1.0, 1.0)

    @property
    def may_be_weaker(self) -> bool:
        """True if the weak thruster has the smallest share: it may deliver less, or nothing."""
        return min(self.shares) <= MIN_SHARE

    @property
    def loss(self) -> Pair:
        """Lost shares of port and starboard in force."""
        return 1.0 - self.shares[0], 1.0 - self.shares[1]

    def update(self, t_ns: int, attribution: Attribution | None, gain: float) -> bool:
        """Take in a cycle of the detector. Return True if the weak thruster has recovered.

        Parameters
        ----------
        t_ns : time of the cycle (ns).
        attribution : the thruster that lost thrust; None without an alarm.
        gain : log-likelihood ratio of this cycle, of no loss against the loss in force (nats).
        """
        if self.is_weak:
            self._recovery = max(self._recovery + gain, 0.0)
            if self._recovery >= RECOVERY_NATS and t_ns - self._since_ns >= LEAST_NS:
                self.restore((1.0, 1.0))
                return True
            # While a recovery may be under way, the detector's window holds cycles from before and after it.
            if attribution is not None and attribution[0] == self._side and self._recovery == 0.0:
                self._set(attribution)
            return False
        same = attribution is not None and attribution[0] == self._side
        self._confirmations = self._confirmations + 1 if same else 1
        self._side = None if attribution is None else attribution[0]
        if attribution is not None and self._confirmations >= CONFIRMING_CYCLES:
            self._set(attribution)
            self._since_ns = t_ns
        return False

    def restore(self, shares: Pair) -> None:
        """Continue with the shares of another controller.

        Parameters
        ----------
        shares : of port and starboard; at most one is below 1.
        """
        self.shares, self._confirmations, self._recovery = shares, 0, 0.0
        self._side = None if not self.is_weak else shares.index(min(shares))

    def health(self, vehicle: Vehicle) -> HealthState:
        """Return the health of the thrusters.

        Parameters
        ----------
        vehicle : gives the largest thrust.
        """
        if self._side is None or not self.is_weak:
            return NOMINAL
        most_N = self.shares[self._side] * vehicle.thrusters[self._side].max_N
        return HealthState(Health.DEGRADED, f"{SIDES[self._side]} thruster weak: box reduced to {most_N:.3g} N")

    def _set(self, attribution: Attribution) -> None:
        """Set the share of a thruster to the nearest step, if it is far enough from the share in force."""
        side, loss = attribution
        share = max(1.0 - loss, MIN_SHARE)
        if abs(share - self.shares[side]) >= HYSTERESIS:
            share = STEP * round(share / STEP)
            self.shares = (share, 1.0) if side == 0 else (1.0, share)
