"""Everything that reads what others wrote: bytes from the bus, files of settings, measurements and recordings.

A target makes a frame from a seed, and takes one: it gives back what was accepted, or None where it was refused with
the error that its documentation names. Whatever else comes out of ``take`` is a crash; what ``check`` raises is a value
that should not have been let in.
"""

from __future__ import annotations

import atexit
import contextlib
import io
import itertools
import math
import struct
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from mcap.writer import Writer
from pymavlink.dialects.v20 import ardupilotmega as dialect
from scipy.sparse import csc_array, eye_array

from ltv_mpc import messages, references
from ltv_mpc.control.config import ControllerConfig
from ltv_mpc.control.failed_qp import ConstraintRow, NamedQp
from ltv_mpc.control.node import ControllerNode
from ltv_mpc.control.solvers.sparse import QP
from ltv_mpc.currents import read_prior, read_profile
from ltv_mpc.errors import ConfigError
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.pd0 import reader as pd0_reader
from ltv_mpc.localisation.pd0.beams import to_beams
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.node import ReceivedMessage
from ltv_mpc.validation import rejection_reason
from ltv_mpc.vehicle.parameters import Vehicle
from services.bus import topics
from services.bus.mailbox import Frame
from services.bus.message_validation import MessageValidator
from services.bus.wire import MAX_PAYLOAD_BYTES, WireError, to_map
from services.edges.edge import Outgoing, Received, Refused
from services.edges.mavlink.codec import Codec, frames_of
from services.edges.mavlink.edge import MavlinkEdge
from services.edges.mavlink.edge import Settings as MavlinkSettings
from services.edges.ros2 import cdr, conversions
from services.edges.ros2.conversions import Settings as Ros2Settings
from services.edges.ros2.edge import Ros2Edge
from services.edges.ros2.middleware import Attachment
from services.edges.ros2.topics import BY_NAME, OUT, SERVICE, TABLE
from services.recording import export, info
from services.recording.reader import Recording
from services.recording.recover import recover, segments
from services.runtime.clock import ClockError, VehicleClock, boot_id
from sim.scenario import Scenario
from tests.fuzz import mutate
from tests.fuzz.mutate import Random
from tests.recorded.pd0_writer import Head, Written, written
from tests.services.bus.messages import EXAMPLES, HEADER
from tests.services.edges.ros2.test_ros2 import odometry

ROOT = Path(__file__).resolve().parents[2]


@dataclass(frozen=True)
class Target:
    """Reader under test. ``weight`` is its relative share of the frames."""

    name: str
    weight: float
    frame: Callable[[Random], bytes]
    take: Callable[[bytes], Any]
    check: Callable[[Any], None]


def numbers(value: object) -> Iterator[float]:
    """Yield every number in a value, recursively."""
    if isinstance(value, np.ndarray):
        if value.dtype.kind in "fiu":
            yield from value.ravel().tolist()
    elif isinstance(value, msgspec.Struct):
        for name in value.__struct_fields__:
            yield from numbers(getattr(value, name))
    elif isinstance(value, dict):
        for inner in value.values():
            yield from numbers(inner)
    elif isinstance(value, tuple | list):
        for inner in value:
            yield from numbers(inner)
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield value


def finite(value: object) -> None:
    """Check that no number of a value is NaN or infinite."""
    for x in numbers(value):
        assert math.isfinite(x), f"{x} in {type(value).__name__}"


# --- the bus ---------------------------------------------------------------------------------------------------------


def signal_is_sound(signal: messages.Message) -> None:
    """Check that a message is finite and its lengths match. Only beams may be NaN, which means no return."""
    match signal:
        case messages.AdcpPing():
            assert signal.beam_velocity_mps.shape == (4, len(signal.range_m))
        case messages.BottomTrack():
            assert signal.range_m.shape == signal.beam_velocity_mps.shape == (4,)
        case messages.Plan():
            knots = len(signal.t_ns)
            assert knots >= 2
            assert signal.thrust_N.shape == (knots, 3)
            assert signal.states.shape == (knots, 6)
            assert (np.diff(signal.t_ns) > 0).all()
        case messages.Estimate():
            if signal.covariance is not None:
                assert signal.covariance.shape == (6, 6)
            if signal.current is not None:
                profile_is_sound(signal.current)
    if isinstance(signal, messages.AdcpPing | messages.BottomTrack):
        assert all(not math.isinf(x) for x in numbers(signal))
        finite(signal.t_ns)
    else:
        finite(signal)


def signals_are_sound(signals: Sequence[messages.Message]) -> None:
    for signal in signals:
        signal_is_sound(signal)


def profile_is_sound(profile: messages.CurrentProfile) -> None:
    shape = (len(profile.depth_m),)
    assert shape != (0,)
    assert profile.north_mps.shape == profile.east_mps.shape == shape
    assert profile.sd_mps is None or profile.sd_mps.shape == shape
    assert (np.diff(profile.depth_m) > 0).all()
    finite(profile)


def hostile_frame(rng: Random, message: dict[str, Any]) -> bytes:
    """Return the bytes of a message with wrong values, structure or bytes; rarely huge, rarely only noise."""
    return mutate.one_of(
        rng,
        (70, lambda: mutate.packed(mutate.tree(rng, message), rng)),
        (15, lambda: mutate.raw(rng, mutate.packed(message, rng))),
        (10, lambda: mutate.raw(rng, mutate.packed(mutate.tree(rng, message), rng))),
        (5, lambda: rng.randbytes(rng.randrange(80))),
        (0.005, lambda: b"\xdd\x00\x0f\xff\xf0" + rng.choice((b"\xc0", b"\x90", b"\x00")) * 0xFFFF0),
        (0.003, lambda: bytes(rng.choice((MAX_PAYLOAD_BYTES, MAX_PAYLOAD_BYTES + 1, 3 << 20)))),
    )


def of_plant(example: messages.Message) -> dict[str, Any]:
    """Return the map of a message, from the plant if every node may publish it."""
    return to_map(example, HEADER) | ({"node": "plant"} if topics.BY_TYPE[type(example)].written_by == "*" else {})


def door_of(topic: topics.Topic) -> Target:
    """Return the target of one key: message validation of decoding, bounds and order."""
    key = topics.key_of(topic.message_type, "plant")
    seeds = [of_plant(example) for example in EXAMPLES if type(example) is topic.message_type]

    def take(frame: bytes) -> Any:
        try:
            return MessageValidator().validate(Frame(topic, key, frame, 0))[0]
        except WireError:
            return None

    return Target(f"wire {key}", 3, lambda rng: hostile_frame(rng, rng.choice(seeds)), take, signal_is_sound)


SQUARE_FENCE = (
    '{"type": "FeatureCollection", "margin_m": 2.0, "origin": {"latitude_deg": 50.2, "longitude_deg": -5.1}, '
    '"features": [{"type": "Feature", "properties": {"zone": "keep_in"}, "geometry": {"type": "Polygon", '
    '"coordinates": [[[-5.2, 50.1], [-5.2, 50.3], [-5.0, 50.3], [-5.0, 50.1], [-5.2, 50.1]]]}}]}'
)


def ros2() -> Target:
    """Target: the edge to ROS 2, all topics and services: a frame gives messages that are sound, or is counted."""
    edge = Ros2Edge(1, Ros2Settings(vehicle=Vehicle.load("paper")))
    edge.take(next(message for message in EXAMPLES if isinstance(message, messages.Plan)), 0)
    seeds = {row.name: cdr.encode(ros2_example(row.ros_type)) for row in TABLE if row.direction is not OUT}
    seeds["odometry"] = odometry(position=(1.0, 2.0, -3.0), frame="a" * 40, pose_covariance=np.eye(6))
    reported = next(message for message in EXAMPLES if isinstance(message, messages.Obstacles))
    text = msgspec.json.encode(reported).decode()
    seeds["obstacles"] = cdr.encode(cdr.make("std_msgs/msg/String", data=text))
    doubles = (math.nan, math.inf, -math.inf, 1e308, 5e-324, 1e10, -1.0)
    names = sorted(seeds)

    def spoiled(rng: Random, data: bytes) -> bytes:
        if len(data) < 12:
            return data[:-1]
        if rng.random() < 0.3:  # the stamp, of messages that begin with a header
            stamp = rng.choice((0, 1, -1, 2**31 - 1, -(2**31), 2_147_000_000)), rng.choice((0, 10**9, 2**32 - 1))
            return data[:4] + struct.pack("<iI", *stamp) + data[12:]
        at = 4 + 8 * rng.randrange((len(data) - 4) // 8)
        return data[:at] + np.array([rng.choice(doubles)]).astype("<f8").tobytes() + data[at + 8 :]

    def frame(rng: Random) -> bytes:
        number = rng.randrange(len(names))
        seed = seeds[names[number]]
        length = rng.choice((0, 0xFFFFFFFF, 0x7FFFFFFF, 65535)).to_bytes(4, "little")
        attachment = Attachment(rng.randrange(1 << 60), 0, bytes(16)).pack()
        payload = mutate.one_of(
            rng,
            (4, lambda: spoiled(rng, seed)),
            (4, lambda: mutate.raw(rng, seed)),
            (1, lambda: seed[:12] + length + seed[16:]),
            (1, lambda: rng.randbytes(rng.randrange(900))),
        )
        attachment = mutate.one_of(rng, (4, bytes), (2, lambda: attachment), (1, lambda: mutate.raw(rng, attachment)))
        return bytes([number, len(attachment) & 255]) + attachment[:255] + payload

    def take(data: bytes) -> Any:
        name = names[data[0] % len(names)]
        attachment, payload = data[2 : 2 + data[1]], data[2 + data[1] :]
        channel = f"{name}?1" if BY_NAME[name].direction is SERVICE else name
        before = edge.accepted, edge.refused
        outputs = edge.receive(Received(channel, payload, attachment, 0))
        assert edge.accepted + edge.refused == sum(before) + 1
        for late in (*edge.step(4_000_000), *edge.release(4_000_000)):  # so that requests do not pile up
            if not isinstance(late, Outgoing):
                signal_is_sound(late)
        return [output for output in outputs if not isinstance(output, Outgoing)] if edge.accepted > before[0] else None

    return Target("ros2", 2, frame, take, signals_are_sound)


def ros2_example(ros_type: str) -> Any:
    """Return a message with zeros, empty texts and one element in each list; of a service its request."""
    if "/srv/" in ros_type:
        return cdr.make(f"{ros_type}_Request", **({"data": True} if ros_type.endswith("SetBool") else {}))
    if ros_type == "std_msgs/msg/String":
        return cdr.make(ros_type, data=SQUARE_FENCE)
    pose = {"position": {"x": 1.0, "y": 2.0, "z": -3.0}, "orientation": {"w": 1.0}}
    vector = {"x": 0.1, "y": 0.2, "z": 0.3}
    twist = {"linear": vector, "angular": vector}
    covariance = np.eye(6).ravel()
    with_pose, with_twist = {"pose": pose, "covariance": covariance}, {"twist": twist, "covariance": covariance}
    header = conversions.header(1, "odom")
    fields: dict[str, dict[str, Any]] = {
        "nav_msgs/msg/Odometry": {"child_frame_id": "base_link", "pose": with_pose, "twist": with_twist},
        "geometry_msgs/msg/PoseWithCovarianceStamped": {"pose": with_pose},
        "geometry_msgs/msg/TwistWithCovarianceStamped": {"twist": with_twist},
        "geometry_msgs/msg/TwistStamped": {"twist": twist},
        "geometry_msgs/msg/PoseStamped": {"pose": pose},
        "nav_msgs/msg/Path": {"poses": [{"header": header, "pose": pose}] * 3},
    }
    return cdr.make(ros_type, header=header, **fields[ros_type])


def mavlink() -> Target:
    """Target: the edge to MAVLink: each frame of a datagram gives messages that are sound, or is counted."""
    autopilot = Codec(1, component=1)
    make = autopilot.make
    quaternion, unknown, known = (1.0, 0.0, 0.0, 0.0), [math.nan] * 21, np.eye(6)[np.triu_indices(6)].tolist()
    seeds = [
        autopilot.encode(message)
        for message in (
            make.heartbeat_encode(11, 3, 0x81, 0, 4),
            make.attitude_encode(1000, 0.1, 0.2, 3.0, 0.0, 0.1, 0.2),
            make.local_position_ned_encode(1000, 1.0, 2.0, 3.0, 0.1, 0.2, 0.3),
            make.odometry_encode(10**6, 1, 12, 1, 2, 3, quaternion, 0.1, 0.2, 0.3, 0, 0, 0.1, unknown, unknown, 0),
            make.odometry_encode(10**6, 1, 12, 1, 2, 3, quaternion, 0.1, 0.2, 0.3, 0, 0, 0.1, known, known, 0),
            make.ekf_status_report_encode(0x1F, 0, 0, 0, 0, 0),
            make.gps_global_origin_encode(502000000, -51000000, 0),
            make.system_time_encode(0, 1000),
            make.timesync_encode(10**9, 1),
            make.mission_current_encode(1),
            make.mission_ack_encode(255, 191, 1, 0),
            make.statustext_encode(4, b"Flight plan received", 0, 0),
            make.mission_count_encode(255, 191, 2, 0),
            make.mission_count_encode(255, 191, 2, 1),
            *(
                make.mission_item_int_encode(255, 191, at, 6, what, 0, 1, 5, 0, 0, 0, 502001000, -51000000, 0, kind)
                for at in (0, 1)
                for what, kind in ((16, 0), (5003, 1), (5004, 1))
            ),
        )
    ]
    state: list[tuple[MavlinkEdge, int]] = [(new_mavlink_edge(), 0)]

    def altered(rng: Random, seed: bytes) -> bytes:
        """Return a frame with another payload and a checksum that is right, so that it passes the decoder."""
        message = Codec(9, component=9).decode(seed)
        payload = mutate.raw(rng, seed[10 : 10 + seed[1]])[: seed[1]].ljust(seed[1], bytes(1))
        return checked(seed[1:10], payload, message.crc_extra)

    def any_kind(rng: Random) -> bytes:
        """Return a frame of any kind of message from the autopilot."""
        number, kind = rng.choice(list(dialect.mavlink_map.items()))
        payload = rng.choice((rng.randbytes, bytes, lambda n: b"\xff" * n))(struct.calcsize(kind.unpacker.format))
        head = bytes([len(payload), 0, 0, rng.randrange(256), 1, 1]) + number.to_bytes(3, "little")
        return checked(head, payload, kind.crc_extra)

    def checked(head: bytes, payload: bytes, extra: int) -> bytes:
        body = head + payload
        return b"\xfd" + body + struct.pack("<H", dialect.x25crc(body + bytes([extra])).crc)

    def frame(rng: Random) -> bytes:
        seed = rng.choice(seeds)
        return mutate.one_of(
            rng,
            (4, lambda: altered(rng, seed)),
            (2, lambda: any_kind(rng)),
            (4, lambda: mutate.raw(rng, seed)),
            (1, lambda: seed + mutate.raw(rng, rng.choice(seeds)) + rng.choice(seeds)),
            (1, lambda: seed),
            (1, lambda: rng.randbytes(rng.randrange(300))),
        )

    def take(data: bytes) -> Any:
        edge, number = state[0]
        if number % 500 == 499:
            edge = new_mavlink_edge()
        state[0] = edge, number + 1
        edge.receive(Received("", seeds[0], b"", number * 1000))
        before, wanted = edge.accepted + edge.refused, len(list(frames_of(data)))
        accepted = edge.accepted
        outputs = edge.receive(Received("", data, b"", number * 1000))
        assert edge.accepted + edge.refused == before + wanted
        outputs += [*edge.step(number * 1000), *edge.release(number * 1000)]
        return [one for one in outputs if not isinstance(one, Outgoing)] if edge.accepted > accepted else None

    return Target("mavlink", 2, frame, take, signals_are_sound)


def into_edges() -> Target:
    """Target: what both edges read from this bus, as far as its readers let it in: it is converted, or refused."""
    ours = (Ros2Edge(1, Ros2Settings(vehicle=Vehicle.load("paper"))), new_mavlink_edge())
    seeds = [(topics.BY_TYPE[type(one)], one) for one in EXAMPLES if type(one) in {*ours[0].reads, *ours[1].reads}]
    state = 0

    def frame(rng: Random) -> bytes:
        number = rng.randrange(len(seeds))
        return bytes([number]) + mutate.packed(mutate.tree(rng, to_map(seeds[number][1], HEADER)), rng)

    def take(data: bytes) -> Any:
        nonlocal state
        state += 100_000
        topic = seeds[data[0] % len(seeds)][0]
        try:
            message, _ = MessageValidator().validate(Frame(topic, topic.key, data[1:], 0))
        except WireError:
            return None
        outputs: list[Any] = []
        for edge in ours:
            if edge.clock.read(0) is None:
                edge.clock.update(10**9, 0)
            if isinstance(message, edge.reads):
                with contextlib.suppress(Refused):
                    outputs += edge.take(message, state)
            outputs += [*edge.step(state), *edge.release(state)]
        return [one for one in outputs if not isinstance(one, Outgoing)]

    return Target("into edges", 2, frame, take, signals_are_sound)


def new_mavlink_edge() -> MavlinkEdge:
    """Return an edge that has received nothing."""
    boat = Vehicle.load("bluerobotics-boat")
    return MavlinkEdge(1, MavlinkSettings(vehicle=boat), Codec(255))


def vehicle_clock() -> Target:
    """Target: the vehicle clock of a process, with clock messages of any sender."""
    topic = topics.BY_TYPE[messages.Clock]
    example = next(e for e in EXAMPLES if isinstance(e, messages.Clock))
    message = to_map(msgspec.structs.replace(example, host_boot_id=boot_id()), HEADER)

    def take(frame: bytes) -> Any:
        clock = VehicleClock()
        try:
            for data in (mutate.packed(message, Random(0)), frame):
                signal, _ = MessageValidator().validate(Frame(topic, "clock", data, 0))
                assert isinstance(signal, messages.Clock)
                clock.follow(msgspec.structs.replace(signal, clock_sequence=signal.clock_sequence + (data is frame)))
        except (WireError, ClockError):
            return None
        instants = (0, 1, 10**6, 10**12, 2**53)
        return [reading for us in instants for reading in (clock.read(us), clock.at(us)) if reading is not None]

    def check(readings: Sequence[int]) -> None:
        assert all(isinstance(reading, int) for reading in readings)

    return Target("clock", 3, lambda rng: mutate.packed(mutate.tree(rng, message), rng), take, check)


def command() -> Target:
    """Target: a controller that receives commands: its reply, and sometimes its next plan."""
    node = ControllerNode(Vehicle.load("paper"), references.Hold(), ControllerConfig(horizon_s=1.5))
    seeds = [*texts("ltv_mpc/references/files", "examples/references"), TIMED_INLINE]
    example = next(e for e in EXAMPLES if isinstance(e, messages.Command))
    times = itertools.count(1)

    def take(toml: bytes) -> Any:
        try:
            told = msgspec.structs.replace(example, reference_toml=toml.decode())
        except UnicodeDecodeError:  # no text, so no message
            return None
        if rejection_reason(told) is not None:
            return None
        count = next(times)
        t_ns = count * 300_000_000
        inbox = [ReceivedMessage(told, 1, count, t_ns)]
        if count % 50 == 0:
            here = msgspec.structs.replace(messages.Estimate.at_rest(depth_m=5.0), t_ns=t_ns)
            inbox.append(ReceivedMessage(here, 1, count, t_ns))
        return node.step(t_ns, inbox)

    def check(said: Sequence[messages.Message]) -> None:
        signals_are_sound(said)
        assert not any(map(rejection_reason, said))

    return Target("command", 0.5, of_text(seeds), take, check)


# --- files -----------------------------------------------------------------------------------------------------------

WORKSHOP = tempfile.TemporaryDirectory(prefix="ltv-mpc-fuzz-")
"""Where files lie while they are read; gone with the process."""
atexit.register(WORKSHOP.cleanup)


LONGEST_ERROR = 2000


def file_reader(
    name: str,
    weight: float,
    frame: Callable[[Random], bytes],
    load: Callable[[Path], Any],
    check: Callable[[Any], None] = finite,
    *,
    file: str,
) -> Target:
    """Target: a reader of a file that is written for each frame. It may only raise ``ConfigError``, with one line."""
    folder = Path(WORKSHOP.name) / name.replace(" ", "-")
    folder.mkdir()
    path = folder / file

    def take(data: bytes) -> Any:
        path.write_bytes(data)
        try:
            return load(path)
        except ConfigError as error:
            said = str(error)
        if len(said) > LONGEST_ERROR or not said.isprintable():
            raise AssertionError(f"an error of {len(said)} characters, or of more than one line")
        return None

    return Target(name, weight, frame, take, check)


def texts(*folders: str, suffix: str = ".toml") -> list[bytes]:
    """Return the shipped files as seeds."""
    return [path.read_bytes() for folder in folders for path in sorted((ROOT / folder).glob(f"*{suffix}"))]


def of_text(seeds: Sequence[bytes]) -> Callable[[Random], bytes]:
    """Return a mutated seed."""
    return lambda rng: mutate.text(rng, rng.choice(seeds))


def settings() -> Iterator[Target]:
    """Targets: the files that a user writes."""
    paths = [*texts("ltv_mpc/references/files", "examples/references"), TIMED_INLINE]
    controller = [b"horizon_s = 5.0\nmax_stages = 34\n[weights]\nposition = 1.0\n", b"period_s = 0.3\n[disturbance]\n"]
    readers: dict[str, tuple[list[bytes], Callable[[str], Any]]] = {
        "vehicle": (texts("ltv_mpc/vehicle/files"), Vehicle.load),
        "sensors": (texts("ltv_mpc/localisation/files", "examples/sensors"), SensorConfig.load),
        "scenario": (texts("sim/scenarios"), Scenario.load),
        "reference": (paths, references.load),
        "controller": (controller, ControllerConfig.load),
        "estimator": ([b"current_sd_mps = 0.04\ndeepest_m = 100.0\ncell_m = 1.0\n"], EstimatorConfig.load),
    }
    for name, (seeds, load) in readers.items():
        yield file_reader(name, 1.5, of_text(seeds), lambda path, load=load: load(str(path)), file=f"{name}.toml")


TIMED_INLINE = b'kind = "timed"\nrows = [[0.0, 1.0, 2.0, 3.0], [10.0, 5.0, 2.0, 4.0], [20.0, 5.0, 9.0, 4.0]]\n'


def tables() -> Iterator[Target]:
    """Targets: the tables that a user provides."""
    head = b"# measured\ndepth_m,v_north_mps,u_east_mps\n"
    profile = head + b"".join(b"%d,0.%d,-0.1\n" % (i, i) for i in range(1, 9))
    prior = b"depth_m,v_north_mps,u_east_mps,sd_mps,sd_common_mps\n" + b"".join(
        b"%d,0.1,-0.1,0.03,0.01\n" % i for i in range(9)
    )
    timed = texts("examples/references", suffix=".csv")
    yield file_reader("currents", 2, of_text([profile]), read_profile, profile_is_sound, file="currents.csv")
    yield file_reader("water prior", 2, of_text([prior, profile]), read_prior, prior_is_sound, file="prior.csv")
    yield file_reader("timed track", 1.5, of_text(timed), timed_by, file="track.csv")


def prior_is_sound(prior: Any) -> None:
    shape = prior.depth_m.shape
    for column in (prior.depth_m, prior.north_mps, prior.east_mps, prior.sd_mps):
        assert column.shape == shape
        finite(column)
    assert 0 <= prior.sd_common_mps <= prior.sd_mps.min()


def timed_by(track: Path) -> Any:
    """Return a reference whose rows are in this file."""
    reference = track.with_name("timed.toml")
    if not reference.exists():
        reference.write_text(f'kind = "timed"\nfile = "{track.name}"\n')
    return references.load(str(reference))


def adcp_file() -> Target:
    """Target: a recording of a profiler. Half of the mutations get a correct checksum again."""
    shape = (4, 4)
    heads = [Head(cells=4, coordinates=k, upward=bool(k % 2)) for k in range(4)]
    beams = np.linspace(-0.5, 0.5, 16).reshape(shape)
    bottom = np.array([0.1, 0.2, -0.1, 0.0])

    def ensemble(t_s: float) -> Written:
        return Written(t_s=t_s, beams_mps=beams, pressure=True, bottom_beams_mps=bottom)

    seeds = [[written(head, ensemble(t_s)) for t_s in (0.0, 1.0, 2.0)] for head in heads]

    def repaired(frame: bytes) -> bytes:
        body = bytearray(frame[:-2])
        body[2:4] = len(body).to_bytes(2, "little")
        return bytes(body) + (sum(body) & 0xFFFF).to_bytes(2, "little")

    def frame(rng: Random) -> bytes:
        ensembles = rng.choice(seeds)[: rng.choice((1, 1, 3))]
        at = rng.randrange(len(ensembles))
        spoiled = mutate.raw(rng, ensembles[at])
        ensembles[at] = repaired(spoiled) if rng.random() < 0.7 else spoiled
        return b"".join(ensembles)

    def load(path: Path) -> Any:
        recording = pd0_reader.read(path)
        return recording, [to_beams(ensemble) for ensemble in recording.ensembles]

    def check(found: Any) -> None:
        recording, beams = found
        whole = sum(loss.length for loss in recording.losses)
        assert recording.lost_bytes == whole <= recording.size
        for ensemble in beams:
            cells = ensemble.velocity_mps.shape[1]
            assert ensemble.direction.shape == (4, 3)
            assert ensemble.velocity_mps.shape == ensemble.below_m.shape == ensemble.good.shape == (4, cells)
            finite(ensemble.direction)
            finite(ensemble.below_m)
            finite(ensemble.depth_m)
            for values in (ensemble.velocity_mps, ensemble.bottom_mps):  # NaN: no return
                assert not np.isinf(values).any()

    return file_reader("pd0", 1.5, frame, load, check, file="dive.pd0")


def failed_qp() -> Target:
    """Target: a saved QP."""
    unit = csc_array(eye_array(2))
    qp = QP(unit, np.array([-1.0, -1.0]), unit, np.zeros(2), np.full(2, 0.5))
    rows = ConstraintRow("slew", 1.0, "N"), ConstraintRow("box", 2.0, "N")
    failed = NamedQp(qp, rows, messages.Solve(status=messages.SolveStatus.INFEASIBLE))
    place = Path(WORKSHOP.name) / "seed.qp"
    failed.save(place)
    seed = place.read_bytes()
    content = msgspec.msgpack.decode(seed)

    def frame(rng: Random) -> bytes:
        return mutate.one_of(
            rng,
            (5, lambda: mutate.packed(mutate.tree(rng, content), rng)),
            (5, lambda: mutate.raw(rng, seed)),
        )

    def check(found: NamedQp) -> None:
        n, m = len(found.qp.q), len(found.qp.l)
        assert found.qp.P.shape == (n, n)
        assert found.qp.A.shape == (m, n)
        assert found.qp.q.shape == (n,)
        assert found.qp.l.shape == found.qp.u.shape == (m,)
        assert len(found.rows) == m
        found.faults()

    return file_reader("failed qp", 1, frame, NamedQp.load, check, file="failed.qp")


def recordings() -> Iterator[Target]:
    """Targets: the recording of a run, cut off, damaged, or forged with correct checksums."""
    keys = [(topics.key_of(type(example), "plant"), to_map(example, HEADER)) for example in EXAMPLES]

    def forged(rng: Random) -> bytes:
        file = io.BytesIO()
        writer: Any = Writer(file, chunk_size=2000)
        writer.start()
        start = rng.choice(("0", "-1000000000", "x", "1e9", "9" * 400, ""))
        metadata = {"start_ns": start} if rng.random() < 0.9 else {}
        metadata["scenario.toml"] = rng.choice(("[", "title = 1"))
        writer.add_metadata(rng.choice(("run", "run", "other")), metadata)
        for key, message in rng.sample(keys, 6):
            named = rng.choice((key, key, key, "../x", "", "plan", "estimate", "event/x"))
            channel = writer.register_channel(named, "json", 0)
            for _ in range(2):
                spoiled = mutate.tree(rng, message) if rng.random() < 0.5 else message
                data = mutate.text(rng, jsoned(spoiled)) if rng.random() < 0.3 else jsoned(spoiled)
                at = rng.choice((0, 10**9, 2**63, 2**64 - 1))
                writer.add_message(channel, at, data, at, rng.getrandbits(32))
        writer.finish()
        return file.getvalue()

    seeds = [forged(Random(k)) for k in range(8)]

    def frame(rng: Random) -> bytes:
        return mutate.one_of(rng, (6, lambda: mutate.raw(rng, rng.choice(seeds))), (4, lambda: forged(rng)))

    def recovered(path: Path) -> Any:
        out = path.with_name("recovered.mcap")
        out.unlink(missing_ok=True)
        made = recover(segments(path), out)
        found = info.read([out])
        assert found.whole, "what was recovered is not whole"
        assert found.messages + found.unreadable == made.messages
        return made

    def exported(path: Path) -> Any:
        folder = path.parent / "out"
        folder.mkdir(exist_ok=True)
        return export.export([path], folder, "csv"), export.export([path], folder, "parquet")

    def read(path: Path) -> Any:
        found = []
        for message in Recording(path):
            with contextlib.suppress(WireError):
                found.append(message.typed()[0])
        return found

    yield file_reader("recover", 0.6, frame, recovered, anything, file="run.mcap")
    yield file_reader("log info", 0.6, frame, lambda path: info.read([path]), finite, file="run.mcap")
    yield file_reader("log export", 0.1, frame, exported, anything, file="run.mcap")
    yield file_reader("recording", 0.6, frame, read, signals_are_sound, file="run.mcap")


def anything(_: object) -> None:
    """Accept any result: it was checked when it was built."""


def jsoned(tree: Any) -> bytes:
    """Return the JSON of a mutated tree; values that JSON cannot hold become texts."""
    return msgspec.json.encode(tree, enc_hook=lambda _: "raw")


def all_targets() -> tuple[Target, ...]:
    """Return the targets of all readers of external data."""
    return (
        *map(door_of, topics.TOPICS),
        *(ros2(), mavlink(), into_edges(), vehicle_clock(), command()),
        *settings(),
        *tables(),
        *(adcp_file(), failed_qp()),
        *recordings(),
    )
