"""Description of a sensor, and the rows in which its measurements reach the filter.

Row     residual_i = z_i - h_i(belief) = sum_j partial_ij error[state_ij] + n_i,  n_i ~ N(0, variance_i), independent
        Scalar measurement, linearised about a belief. It depends on few of the states and names them. A padded entry
        has partial 0 and any state.
"""

from __future__ import annotations

import enum
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, Protocol, TypeAlias, TypeVar

import numpy as np
import numpy.typing as npt

from ltv_mpc.jit import jit
from ltv_mpc.localisation.filter.state import Belief
from ltv_mpc.localisation.sensors.settings import SensorSettings
from ltv_mpc.messages import Array, Message, Triple

if TYPE_CHECKING:  # the sensor configuration imports every sensor, and every sensor imports this file
    from ltv_mpc.localisation.sensor_config import SensorConfig

Indices: TypeAlias = npt.NDArray[np.int64]


class Rows(NamedTuple):
    """Set of m scalar measurements of one instant, each of which depends on at most w states."""

    state: Indices  # (m, w)
    partial: Array  # (m, w)
    residual: Array  # (m,)
    variance: Array  # (m,)

    def times(self, A: Array) -> Array:
        """Return the product H A of the measurement matrix H (m, n), (m, k).

        Parameters
        ----------
        A : (n, k), C-contiguous.
        """
        product = np.zeros((len(self.residual), A.shape[1]))
        _add_product(self.state, self.partial, A, product)
        return product


@jit
def _add_product(state: Indices, partial: Array, A: Array, product: Array) -> None:
    """Add H A to the product."""
    for i in range(state.shape[0]):
        for w in range(state.shape[1]):
            row, factor, to = A[state[i, w]], partial[i, w], product[i]
            for j in range(len(row)):  # over whole rows it is vectorised
                to[j] += factor * row[j]


_NO_ROWS = Rows(np.empty((0, 1), dtype=np.int64), np.empty((0, 1)), np.empty(0), np.empty(0))


@dataclass(frozen=True, slots=True, kw_only=True)
class Linearised:
    """Rows of one message, and the number of its scalar measurements that cannot be used, by reason."""

    rows: Rows
    indices: Indices | None = None  # (m,), of each row in its message; None: 0, 1, 2, ...
    unused: Mapping[str, int] = field(default_factory=dict)


def unusable(reason: str, count: int) -> Linearised:
    """Return the result for a message of which no measurement can be used.

    Parameters
    ----------
    reason : key of the account.
    count : number of scalar measurements in the message.
    """
    return Linearised(rows=_NO_ROWS, unused={reason: count})


M = TypeVar("M", bound=Message)
S = TypeVar("S", bound=SensorSettings)


class Measurement(Protocol):
    """A message that corrects the filter. Inertial samples propagate it instead."""

    @property
    def t_ns(self) -> int:
        """Validity time (ns)."""
        ...


class Availability(enum.Enum):
    """Times at which the messages of a sensor can be expected.

    CONTINUOUS: a message at every multiple of the period, up to losses. An estimate waits for it if it has no latency.
    SURFACE: the same while the vehicle is at the surface, before the descent begins at t = 0. Silence after that is
    normal. One such fix may be all that a descent has, so outliers just beyond the gate are de-weighted, not rejected.
    INTERMITTENT: messages come seldom or with a latency that varies.

    The mean squared innovation of a sensor that is not continuous is judged by its upper limit alone: its messages are
    few, and the variance of some contains a second-order term.
    """

    CONTINUOUS = enum.auto()
    SURFACE = enum.auto()
    INTERMITTENT = enum.auto()


class Context(NamedTuple):
    """Quantities that a measurement model may use in addition to the belief, the message and its own settings."""

    sensor_config: SensorConfig  # settings of all sensors
    cell_m: float  # spacing of the grid points of the water (m)
    rate: Triple  # angular rate that the inertial unit measured last, bias included (rad/s, body)


@dataclass(frozen=True, slots=True, kw_only=True)
class Sensor(Generic[M, S]):
    """Description of a sensor, one constant in the sensor's file."""

    name: str
    """In the sensors file, in the account and in reports."""
    message: type[M]
    settings: type[S]
    scalars_per_message: int
    """Scalar measurements in a message. The account counts them as not fitted if the vehicle lacks the sensor."""
    at_rest: Callable[[int, S], M]
    """Message of a given time (ns) from a vehicle at rest at the origin, for the warm-up of compiled code. Messages
    of different times differ in their ``reading``."""
    linearise: Callable[[Belief, M, S, Context], Linearised] | None
    """Measurement model; None: the sensor propagates the filter."""
    availability: Availability = Availability.CONTINUOUS
    is_essential: bool = False
    """It bounds the error of velocity or depth: the filter is inconsistent if this sensor alone is rejected."""
    clones_position: bool = False
    """The position of the message's time becomes a state, as the reference of the next displacement."""
    reading: Callable[[M], object] | None = None
    """Values that never repeat exactly, so that a repetition shows a frozen sensor. None: they may repeat."""
    source: Callable[[M], object] | None = None
    """Identity of the emitter, if the sensor has several: their messages may have one time and come in any order."""


AnySensor = Sensor[Any, Any]
