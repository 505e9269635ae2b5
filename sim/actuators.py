"""Path of a command to the propellers' governors: dead time, quantisation and dead zone.

    y_q(t) = q round(y(t - dead time) / q),  0 where |y_q| < dead zone

A motor driver rounds its pulse width to steps, and does not start its motor below a least one: the motor stands still,
then jumps to its least speed. Gate and report of the actuators know the command y alone. The path of each thruster is
the same.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ltv_mpc.messages import Array
from sim.scenario import Actuators


class CommandPath:
    """Commands on their way to the propellers."""

    def __init__(self, settings: Actuators) -> None:
        self._settings = settings
        self._dead_ns = round(settings.dead_time_s * 1e9)
        self._t_ns, self._sent = np.empty(0), np.zeros((1, 3))  # what is still needed of the commands

    def followed(self, t_ns: Sequence[int], commands: Array) -> Array:
        """Return what the governors follow at t_ns[1:], (K, 3) in N.

        Parameters
        ----------
        t_ns : (K+1,) vehicle time (ns); the first is the last one of the call before.
        commands : (K, 3) commands (N) at t_ns[1:], linear between them.
        """
        if self._settings == Actuators():
            return commands
        out = commands
        if self._dead_ns:
            self._t_ns = np.append(self._t_ns if len(self._t_ns) else t_ns[0], t_ns[1:]).astype(np.float64)
            self._sent = np.vstack([self._sent, commands])
            at = np.array(t_ns[1:], dtype=np.float64) - self._dead_ns
            out = np.column_stack([np.interp(at, self._t_ns, sent) for sent in self._sent.T])
            gone = max(int(np.searchsorted(self._t_ns, at[-1])) - 1, 0)
            self._t_ns, self._sent = self._t_ns[gone:], self._sent[gone:]
        if quantum := self._settings.quantum_N:
            out = quantum * np.round(out / quantum)
        return np.where(np.abs(out) < self._settings.dead_zone_N, 0.0, out)
