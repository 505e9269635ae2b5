"""Runs in Python: simulated in this process or read from a folder, as numpy arrays by name.

``ltv_mpc.simulate`` and ``ltv_mpc.Run`` are these names.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
import numpy.typing as npt

from ltv_mpc.control.failed_qp import NamedQp
from ltv_mpc.control.ocp.extension import Limit, Term
from ltv_mpc.control.solvers.recorder import QpRecorder
from ltv_mpc.errors import ConfigError, naming
from ltv_mpc.messages import ImuSamples, Message, Plan, StepRecord
from ltv_mpc.settings_schema import scalar_fields, suggestion
from ltv_mpc.validation import bounds
from services.bus import topics
from services.bus.wire import WireError
from services.recording.reader import Recording
from services.recording.recover import segments
from services.run import folder
from services.run.nodes import make_nodes
from services.run.run_config import Override, resolve
from services.run.summary import summarise_recording
from services.tools import lockstep_run
from sim.evaluation.summary import Summary
from sim.scenario import Scenario

if TYPE_CHECKING:
    import pandas

Column = npt.NDArray[Any]


def simulate(
    scenario: str | Path,
    *,
    out: str | Path | None = None,
    terms: Sequence[Term | Limit] = (),
    qps: bool = False,
    **changes: Any,
) -> Run:
    """Run a scenario in lock step in this process, as ``ltv-mpc sim SCENARIO --lockstep`` does.

    Parameters
    ----------
    scenario : name of a shipped scenario, or path of a TOML file.
    out : folder for the files of the run, new or empty; None: none are written.
    terms : cost terms and limits of your own, as ``Controller`` takes them; not with ``out``, whose files cannot hold
        them.
    qps : True keeps the QP of each plan in ``Run.qps``; not with ``out``.
    changes : settings by the last part of their key (``seed=3``, ``horizon_s=5.0``), or tables of settings
        (``water={"sd_mps": 0.08}``) where that is not unique.

    Raises
    ------
    ConfigError : a setting is unknown, ambiguous or out of its bounds, or the folder is not empty.
    """
    run_config = resolve(str(scenario), list(_overrides(changes)))
    if out is not None:
        if terms or qps:
            raise ConfigError("argument out", "", "cannot act together with terms or qps")
        place = folder.make(run_config.name, run_config.files, out=Path(out))
        lockstep_run.run(run_config, place)
        return Run.load(place.path)
    recorder, kept = QpRecorder(), list[NamedQp | None]()
    messages: dict[str, list[Message]] = {}

    def keep(message: Message) -> None:
        messages.setdefault(topics.BY_TYPE[type(message)].key, []).append(message)
        if qps and isinstance(message, Plan):
            kept.append(recorder.newest())

    nodes = make_nodes(run_config, terms=terms, make_solver=recorder)
    summary = lockstep_run.simulate(run_config, nodes=nodes, keep=keep)
    return Run(run_config.name, messages, msgspec.to_builtins(summary), kept)


class Run(Mapping[str, "Table"]):
    """Simulated or recorded run: a table of arrays for each key, as ``run["estimate"]["north_m"]``.

    The keys are those of the protocol (``ltv-mpc topics``). ``summary`` has the content of summary.json; it is empty
    for the recording of a real vehicle.
    """

    def __init__(
        self,
        name: str,
        messages: Mapping[str, Sequence[Message]],
        summary: Mapping[str, Any],
        qps: Sequence[NamedQp | None] = (),
    ) -> None:
        """Take the messages of a run by their keys.

        Parameters
        ----------
        name : of the scenario or folder.
        messages : by key, in the order of their publication.
        summary : results.
        qps : QP of each plan.
        """
        self.name, self.messages, self.summary, self.qps = name, messages, summary, qps
        self._tables: dict[str, Table] = {}

    @classmethod
    def load(cls, path: str | Path) -> Run:
        """Read a run, also one that was cut off or that a vehicle recorded.

        Parameters
        ----------
        path : folder of a run, its run.mcap, or ``latest`` for the newest one below runs/.

        Raises
        ------
        ConfigError : there is no recording.
        """
        recording = folder.find(str(path))
        messages: dict[str, list[Message]] = {}
        for stored in Recording(*segments(recording)):
            if stored.kind not in (None, StepRecord):
                try:
                    messages.setdefault(stored.key, []).append(stored.message())
                except WireError:  # as its readers did
                    continue
        return cls(recording.absolute().parent.name, messages, summary_of(recording))

    def __getitem__(self, key: str) -> Table:
        """Return the table of a key."""
        if key not in self.messages:
            raise KeyError(f"no messages on {key!r}{suggestion(key, self.messages)}")
        if key not in self._tables:
            self._tables[key] = Table(self.messages[key])
        return self._tables[key]

    def __iter__(self) -> Iterator[str]:
        """Yield the keys."""
        return iter(self.messages)

    def __len__(self) -> int:
        """Return the number of keys."""
        return len(self.messages)

    def __repr__(self) -> str:
        """Name the run and its keys with their numbers of messages."""
        counts = ", ".join(f"{key} {len(messages)}" for key, messages in self.messages.items())
        return f"<Run {self.name}: {counts}>"


class Table(dict[str, Column]):
    """Messages of one key as arrays by field, the first index over messages.

    Names end with their unit, as on the bus; ``units`` has them apart. ``t_s`` is ``t_ns`` in seconds. A part of a
    message is ``outer.inner``. A missing number is NaN; an array of objects holds what differs in size or is a list of
    parts.
    """

    def __init__(self, messages: Sequence[Message]) -> None:
        """Take messages of one type; of inertial ones each sample."""
        samples = (one.samples for one in messages if isinstance(one, ImuSamples))
        one_each: Sequence[Any] = list(itertools.chain.from_iterable(samples)) or messages
        columns, units = dict[str, Column](), dict[str, str]()
        for name, column, unit in _columns(one_each):
            columns[name] = column
            units |= {name: unit} if unit else {}
        super().__init__({"t_s": columns["t_ns"] * 1e-9, **columns} if "t_ns" in columns else columns)
        self.units: Mapping[str, str] = {"t_s": "s", **units}
        """Units by name; names without one are left out."""

    def to_pandas(self) -> pandas.DataFrame:
        """Return a data frame; a field with several numbers has a column for each, ``name_0``, ``name_1``.

        Raises
        ------
        ImportError : pandas is not installed.
        """
        import pandas

        flat: dict[str, Column] = {}
        for name, values in self.items():
            places = np.ndindex(values.shape[1:])  # of a number: one, ()
            flat |= {"_".join((name, *map(str, place))): values[(slice(None), *place)] for place in places}
        return pandas.DataFrame(flat)

    def __missing__(self, name: str) -> Column:
        """Say which field was probably meant."""
        raise KeyError(f"no field {name!r}{suggestion(name, self)}")

    def __repr__(self) -> str:
        """Name the fields with their shapes."""
        return f"<Table {', '.join(f'{name} {values.shape}' for name, values in self.items())}>"


def summary_of(recording: Path) -> dict[str, Any]:
    """Return the content of the summary.json beside a recording; if there is none, the summary of the recording.

    It is empty for the recording of a real vehicle: without a truth there are no errors to summarise. Raises
    ``ConfigError`` if a figure in the file has a wrong type.
    """
    if found := folder.read_summary(recording):
        for field in (field for field in msgspec.structs.fields(Summary) if field.name in found):
            with naming(f"summary {recording.with_name('summary.json')}", field.name):
                msgspec.convert(found[field.name], field.type)
        return found
    try:
        run_config = resolve(str(recording.with_name("scenario.toml")))
    except ConfigError:
        return {}
    graded = summarise_recording(run_config, recording)[0]
    plain: dict[str, Any] = msgspec.to_builtins(graded) if graded.cycles or graded.why else {}
    return {key: value for key, value in plain.items() if key not in ("mode", "speed")}  # taken from the recording


def _overrides(changes: Mapping[str, Any], table: str = "") -> Iterator[Override]:
    """Yield the settings that arguments change. Raises ``ConfigError``."""
    known = scalar_fields(Scenario)
    for name, value in changes.items():
        if isinstance(value, Mapping):
            yield from _overrides(value, f"{table}{name}.")
            continue
        key, source = f"{table}{name}", f"argument {table}{name}"
        keys = [one for one in known if one.endswith(f".{key}")]
        if key not in known and len(keys) > 1:
            raise ConfigError(source, "", f"is one of {', '.join(keys)}: give it in its table, as a dict")
        text = value if isinstance(value, str) else str(value) if isinstance(value, Path) else json.dumps(value)
        yield Override(source, [f"{key if key in known or not keys else keys[0]}={text}"])


def _columns(messages: Sequence[Any], prefix: str = "") -> Iterator[tuple[str, Column, str]]:
    """Yield name, array and unit of each field of structs, None for a part that some of them lack."""
    kind: type[msgspec.Struct] = type(next(message for message in messages if message is not None))
    limits = bounds(kind)
    for name in kind.__struct_fields__:
        values = [None if message is None else getattr(message, name) for message in messages]
        known = next((value for value in values if value is not None), None)
        if isinstance(known, msgspec.Struct):
            yield from _columns(values, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", _array(values, known), limits[name].unit if name in limits else ""


def _array(values: Sequence[Any], known: Any) -> Column:
    """Return an array over the messages; ``known`` is one of the values, None if all are missing."""
    if known is None:
        return np.full(len(values), np.nan)
    if isinstance(known, str):
        return np.array([value if value is None else str(value) for value in values], dtype=object)
    try:
        sample = np.asarray(known)
        if sample.dtype.kind in "biuf":
            lacking = np.full(sample.shape, np.nan)
            return np.array([lacking if value is None else value for value in values])
    except ValueError:
        pass
    column = np.empty(len(values), dtype=object)
    column[:] = values
    return column
