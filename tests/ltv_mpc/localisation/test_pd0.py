"""PD0 files: round trip through a writer; damage costs only the affected ensembles and is reported."""

from __future__ import annotations

import math
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ltv_mpc.errors import ConfigError
from ltv_mpc.frames import rotation
from ltv_mpc.localisation.pd0 import reader
from ltv_mpc.localisation.pd0.beams import BeamEnsemble, to_beams
from ltv_mpc.localisation.pd0.records import Coordinates
from ltv_mpc.localisation.sensors.adcp import beam_directions
from tests.recorded.pd0_writer import BEAM, EARTH, INSTRUMENT, SHIP, Head, Written, written

RNG = np.random.default_rng(7)
AHEAD, ASTERN, STARBOARD, PORT = range(4)


def parse(data: bytes) -> reader.Recording:
    return reader.parse(data, source="PD0 file test.PD0")


def one(head: Head, ensemble: Written) -> BeamEnsemble:
    """Write and read ensembles."""
    return to_beams(parse(written(head, ensemble)).ensembles[0])


def still(head: Head, t_s: float = 0.0, **more: object) -> Written:
    """Return an ensemble of noise."""
    return Written(t_s=t_s, beams_mps=0.3 * RNG.standard_normal((head.cells, 4)), **more)


def water(velocity_enu: tuple[float, float, float], directions_enu: np.ndarray, cells: int) -> np.ndarray:
    """Return the velocities that beams along ``directions_enu`` measure of moving water, in the file's sign."""
    return np.tile(-directions_enu @ np.array(velocity_enu), (cells, 1))


HEADS = [
    Head(coordinates=coordinates, upward=upward, convex=convex, beam_angle_deg=angle, frequency_kHz=kilohertz)
    for coordinates in (BEAM, INSTRUMENT, SHIP, EARTH)
    for upward in (False, True)
    for convex, angle, kilohertz in ((True, 20, 1200), (True, 30, 600), (False, 15, 300), (True, 25, 150))
]


@pytest.mark.parametrize("tilts_used", [True, False])
@pytest.mark.parametrize("head", HEADS, ids=str)
def test_beams_come_back_from_every_coordinate_system(head: Head, tilts_used: bool) -> None:
    head = Head(**{**vars(head), "tilts_used": tilts_used})
    ensemble = still(head, heading_deg=211.0, pitch_deg=-24.0, roll_deg=11.0)
    back = one(head, ensemble)
    # in the file beams 1 to 4; seen from above with beam 3 ahead, looking down, beam 2 is to starboard
    sides = [0, 1] if head.upward == head.convex else [1, 0]
    order = [2, 3, *sides] if head.convex else [3, 2, *sides]
    # half a millimetre per second of each of four rounded components
    np.testing.assert_allclose(back.velocity_mps, -ensemble.beams_mps[:, order].T, atol=0.002)


@given(st.floats(0, 359.99), st.floats(-60, 60), st.floats(-60, 60), st.sampled_from([15, 20, 25, 30]))
def test_beams_that_look_down_point_where_the_projects_own_do(
    heading: float, pitch: float, roll: float, angle: int
) -> None:
    """Independent formula: R = Rz Ry Rx of the frames, e_i of the simulated profiler."""
    head = Head(beam_angle_deg=angle, cells=1)
    heading, pitch, roll = (round(x, 2) for x in (heading, pitch, roll))
    back = one(head, still(head, heading_deg=heading, pitch_deg=pitch, roll_deg=roll))
    gimbal = math.atan(math.tan(math.radians(pitch)) * math.cos(math.radians(roll)))
    R = rotation(math.radians(roll), gimbal, math.radians(heading))
    np.testing.assert_allclose(back.direction, beam_directions(math.radians(angle)) @ R.T, atol=1e-9)


@pytest.mark.parametrize("head", [head for head in HEADS if head.coordinates == EARTH], ids=str)
def test_the_beams_order_is_ahead_astern_starboard_port_whatever_the_head(head: Head) -> None:
    u = one(head, still(head, heading_deg=0)).direction
    s = math.sin(math.radians(head.beam_angle_deg))
    np.testing.assert_allclose(u[:, :2], [[s, 0], [-s, 0], [0, s], [0, -s]], atol=1e-9)
    assert ((u[:, 2] < 0) == head.upward).all()


def test_by_hand_water_from_astern_and_the_bottom_below_a_vehicle_that_heads_east() -> None:
    """Heading 90 deg, level, beams at 30 deg; water passes the instrument to the east at 0.4 m/s.

    Beam 3 looks east and down: the water goes away from it at 0.4 sin 30 = 0.2 m/s. Beam 4 sees it come, 1 and 2 see
    nothing. The vehicle itself goes 0.5 m/s south over ground and down at 0.1 m/s: for it the bottom goes north and up.
    """
    head = Head(cells=2, beam_angle_deg=30)
    s, k = 0.5, math.sqrt(0.75)
    # beams 1 to 4, east north up: port is north of a vehicle that heads east
    directions = np.array([[0, s, -k], [0, -s, -k], [s, 0, -k], [-s, 0, -k]])
    seen = water((0.4, 0, 0), directions, 2)
    np.testing.assert_allclose(seen[0], [0, 0, -0.2, 0.2], atol=1e-12)
    bottom = water((0, 0.5, 0.1), directions, 1)[0]
    for coordinates in (BEAM, INSTRUMENT, SHIP, EARTH):
        head.coordinates = coordinates
        ensemble = Written(t_s=0, beams_mps=seen, heading_deg=90, bottom_beams_mps=bottom)
        back = one(head, ensemble)
        np.testing.assert_allclose(back.velocity_mps[:, 0], [0.2, -0.2, 0, 0], atol=0.002)
        np.testing.assert_allclose(back.direction[AHEAD], [0, s, k], atol=1e-9)  # north, east, down
        np.testing.assert_allclose(back.direction[STARBOARD], [-s, 0, k], atol=1e-9)
        np.testing.assert_allclose(back.bottom_mps, [-0.5, 0, 0.1], atol=0.003)


def test_earth_coordinates_in_the_file_are_east_north_up_relative_to_the_instrument() -> None:
    """Bytes written by hand, independent of the writer's transformations."""
    head = Head(cells=1, beam_angle_deg=30, coordinates=EARTH)
    data = bytearray(written(head, still(head, heading_deg=0)))
    at = bytes(data).index(struct.pack("<H", 0x0100), 6 + 2 * 5 + 59 + 60)
    struct.pack_into("<4h", data, at + 2, 300, -200, 100, 0)  # east, north, up, error in mm/s
    z = to_beams(parse(summed(data)).ensembles[0]).velocity_mps[:, 0]
    k = math.cos(math.radians(30))
    # away from a beam is along it; up is against every beam
    np.testing.assert_allclose(z, np.array([-0.1, 0.1, 0.15, -0.15]) - 0.1 * k, atol=1e-9)


def test_tilts_turn_the_beams_as_the_manual_says() -> None:
    """Pitch positive: beam 3 higher than beam 4. Roll positive: down-looking, beam 1 higher; up-looking, beam 2."""
    for upward in (False, True):
        head = Head(cells=1, upward=upward, beam_angle_deg=30, coordinates=BEAM)
        pitched = one(head, still(head, pitch_deg=30))
        rolled = one(head, still(head, roll_deg=20))
        assert pitched.direction[AHEAD, 2] < pitched.direction[ASTERN, 2]
        straight = AHEAD if upward else ASTERN  # beams at 30 deg: one of them becomes vertical
        np.testing.assert_allclose(pitched.direction[straight], [0, 0, -1 if upward else 1], atol=1e-9)
        # down-looking, beam 1 is to port; up-looking, beam 2 is
        assert rolled.direction[PORT, 2] < rolled.direction[STARBOARD, 2]
        assert rolled.direction[PORT, 1] < 0 < rolled.direction[STARBOARD, 1]
        tilted = math.cos(math.radians(50)), math.cos(math.radians(10))
        np.testing.assert_allclose(sorted(abs(rolled.direction[2:, 2])), sorted(tilted), atol=1e-9)


@pytest.mark.parametrize("coordinates", [INSTRUMENT, SHIP, EARTH])
@pytest.mark.parametrize("lost", range(4))
def test_a_three_beam_solution_gives_its_three_beams_and_no_fourth(coordinates: int, lost: int) -> None:
    head = Head(coordinates=coordinates)
    ensemble = still(head, heading_deg=33, pitch_deg=-26, roll_deg=4)
    ensemble.beams_mps[3, lost] = np.nan
    back = one(head, ensemble).velocity_mps
    expected = -ensemble.beams_mps[:, [2, 3, 1, 0]].T
    assert np.isnan(back[:, 3]).tolist() == np.isnan(expected[:, 3]).tolist()
    np.testing.assert_allclose(back, expected, atol=0.002)


def test_without_correlations_the_fourth_beam_is_the_one_that_lies_flattest() -> None:
    head = Head(coordinates=EARTH, cells=2)
    ensemble = still(head, pitch_deg=-26)  # nose down: beam 4 lies flattest
    ensemble.beams_mps[:, 3] = np.nan
    data = bytearray(written(head, ensemble))
    struct.pack_into("<H", data, struct.unpack_from("<H", data, 12)[0], 0x9999)
    back = to_beams(parse(summed(data)).ensembles[0])
    assert np.isnan(back.velocity_mps).all(axis=1).tolist() == [False, True, False, False]
    np.testing.assert_allclose(back.velocity_mps[AHEAD], -ensemble.beams_mps[:, 2], atol=0.002)


def test_good_pings_are_those_of_three_and_of_four_beams_or_of_each_beam() -> None:
    percent = np.array([[10, 20, 30, 40], [100, 0, 0, 0], [0, 0, 0, 100], [0, 60, 40, 0]], dtype=float)
    for coordinates in (INSTRUMENT, SHIP, EARTH):
        head = Head(coordinates=coordinates, cells=4)
        good = one(head, still(head, percent_good=percent)).good
        np.testing.assert_allclose(good, np.tile([0.5, 1.0, 1.0, 0.0], (4, 1)))
    head = Head(coordinates=BEAM, cells=4)
    good = one(head, still(head, percent_good=percent)).good
    np.testing.assert_allclose(good, percent[:, [2, 3, 1, 0]].T / 100)


def test_two_lost_beams_leave_nothing_but_in_beam_coordinates_the_other_two() -> None:
    for coordinates in (BEAM, EARTH):
        head = Head(coordinates=coordinates, cells=3)
        ensemble = still(head)
        ensemble.beams_mps[1, :2] = np.nan
        missing = np.isnan(one(head, ensemble).velocity_mps)
        assert missing[:, 1].sum() == (2 if coordinates == BEAM else 4)
        assert not missing[:, [0, 2]].any()


def test_bottom_track_of_three_beams_is_a_velocity_too() -> None:
    k, s = math.sqrt(0.75), 0.5
    directions = np.array([[-s, 0, -k], [s, 0, -k], [0, s, -k], [0, -s, -k]])  # heading north
    for coordinates in (BEAM, INSTRUMENT, SHIP, EARTH):
        beams = water((0.1, 0.2, 0.3), directions, 1)[0]
        beams[1] = np.nan
        back = one(Head(coordinates=coordinates), still(Head(), bottom_beams_mps=beams))
        np.testing.assert_allclose(back.bottom_mps, [-0.2, -0.1, 0.3], atol=0.003)


def test_mapped_bins_lie_at_one_depth_and_others_at_one_range() -> None:
    d = 2.94 + 2.0 * np.arange(20)
    tilted = {"pitch_deg": -26.0, "roll_deg": 5.0}
    for upward, sign in ((False, 1.0), (True, -1.0)):
        mapped = one(Head(upward=upward), still(Head(), **tilted))
        np.testing.assert_allclose(mapped.below_m, sign * np.tile(d, (4, 1)))
        for head in (Head(upward=upward, bins_mapped=False), Head(upward=upward, coordinates=BEAM)):
            back = one(head, still(head, **tilted))
            np.testing.assert_allclose(back.below_m, back.direction[:, 2:] * d / math.cos(math.radians(30)))


def test_depth_is_of_the_pressure_where_there_is_one() -> None:
    assert one(Head(), still(Head(), depth_m=12.34)).depth_m == 12.3  # decimetres
    assert one(Head(), still(Head(), depth_m=12.34, pressure=True)).depth_m == pytest.approx(12.34, abs=0.001)


def test_settings_time_and_counts_are_those_of_the_file() -> None:
    head = Head(frequency_kHz=300, upward=True, cells=7, cell_cm=150, first_cm=321, pings=45, coordinates=SHIP)
    counts = {name: RNG.integers(0, 101, (7, 4)).astype(float) for name in ("correlation", "echo", "percent_good")}
    more = {"bottom_beams_mps": np.zeros(4), "spare": b"\x34\x12 what nobody knows"}
    ensemble = parse(written(head, still(head, 61.25, number=70_000, **counts, **more))).ensembles[0]
    s = ensemble.settings
    assert (s.frequency_kHz, s.upward, s.convex, s.cells, s.pings) == (300, True, True, 7, 45)
    assert (s.cell_m, s.first_cell_m, s.coordinates) == (1.5, 3.21, Coordinates.SHIP)
    assert (s.tilts_used, s.bins_mapped) == (True, True)
    assert ensemble.number == 70_000
    assert ensemble.t_ns == 1_466_659_179_000_000_000 + 61_250_000_000  # 2016-06-23 05:19:39 UTC
    for name, expected in counts.items():
        np.testing.assert_array_equal(getattr(ensemble, name), expected)
    np.testing.assert_allclose(ensemble.bottom_mps, 0.0)


HEAD = Head(cells=4, coordinates=BEAM)
FRAMES = [written(HEAD, still(HEAD, 4.0 * k, number=k, bottom_beams_mps=np.zeros(4))) for k in range(5)]
FILE = b"".join(FRAMES)


def numbers(recording: reader.Recording) -> list[int]:
    return [e.number for e in recording.ensembles]


@given(st.integers(0, len(FRAMES[2]) - 1), st.integers(1, 255))
def test_one_changed_byte_costs_its_ensemble_and_no_other(place: int, change: int) -> None:
    data = bytearray(FILE)
    at = 2 * len(FRAMES[0]) + place
    data[at] ^= change
    recording = parse(bytes(data))
    assert numbers(recording) == [0, 1, 3, 4]
    (loss,) = recording.losses
    assert (loss.offset, loss.length) == (2 * len(FRAMES[0]), len(FRAMES[2]))
    if place >= 4:  # neither the mark nor the length
        assert f"byte {loss.offset} has checksum " in loss.why
    assert recording.lost_bytes + len(FRAMES[0]) * len(recording.ensembles) == len(FILE) == recording.size


@pytest.mark.parametrize("left", [1, 2, 5, 6, 7, 8, 100, len(FRAMES[0]) - 1])
def test_a_file_that_was_cut_off_is_read_up_to_there(left: int) -> None:
    recording = parse(FILE[: 3 * len(FRAMES[0]) + left])
    assert numbers(recording) == [0, 1, 2]
    (loss,) = recording.losses
    assert (loss.offset, loss.length) == (3 * len(FRAMES[0]), left)
    if left > 6:
        assert f"the file ends after {left} of them" in loss.why


def test_other_bytes_before_between_and_behind_are_passed_over_and_counted() -> None:
    chatter = b"$GPRMC,051939,A\r\n\x7f\x7f\x00\x00"
    recording = parse(chatter + FRAMES[0] + chatter + FRAMES[1] + chatter)
    assert numbers(recording) == [0, 1]
    assert [loss.length for loss in recording.losses] == 3 * [len(chatter)]
    assert recording.ensembles[1].offset == 2 * len(chatter) + len(FRAMES[0])


@pytest.mark.parametrize(
    ("data", "where", "why"),
    [
        (b"", "byte 0", "empty"),
        (b"PK\x03\x04 no such thing", "byte 0", "no header 7F 7F"),
        (b"abc" + FRAMES[0][:-1], "byte 0", "the ensemble at byte 3"),
        (257 * b"\xff" + FRAMES[0][:-1] + b"\x00", "byte 0", "the ensemble at byte 257 has checksum 00"),
        (b"\x7f" * 300, "byte 0", "the file ends after 300 of them"),
    ],
)
def test_without_one_ensemble_a_file_is_refused_with_the_offset(data: bytes, where: str, why: str) -> None:
    with pytest.raises(ConfigError, match="no valid ensemble") as error:
        parse(data)
    assert error.value.field == where
    assert why in str(error.value)


def summed(frame: bytearray) -> bytes:
    """Return a frame with a corrected checksum."""
    struct.pack_into("<H", frame, len(frame) - 2, sum(frame[:-2]) & 0xFFFF)
    return bytes(frame)


FIXED = struct.unpack_from("<H", FRAMES[0], 6)[0]
VARIABLE = struct.unpack_from("<H", FRAMES[0], 8)[0]


@pytest.mark.parametrize(
    ("place", "content", "why"),
    [
        (5, b"\xff", "do not fit|data type at"),
        (6, b"\xff\xff", "data type at offset 65535"),
        (6, b"\x00\x00", "data type at offset 0"),
        (FIXED, b"\x99\x99", "no fixed leader"),
        (VARIABLE, b"\x99\x99", "no variable leader"),
        (FIXED + 4, b"\x0f", "unknown frequency code 7"),
        (FIXED + 8, b"\x03", "3 beams"),
        (FIXED + 9, b"\x00", "no cells"),
        (FIXED + 9, b"\xff", "velocity cut off"),
        (FIXED + 10, b"\x00\x00", "no cells, pings"),
        (FIXED + 12, b"\x00\x00", "cell length"),
        (VARIABLE + 5, b"\x0d", "not a valid date"),
        (VARIABLE + 18, b"\xff\xff", "outside its range"),
        (VARIABLE + 20, b"\x28\x23", "outside its range"),  # pitch 90 deg
        (VARIABLE + 4, b"\x0f", "does not increase"),  # a year earlier
    ],
)
def test_content_that_cannot_be_is_refused_although_its_checksum_is_right(place: int, content: bytes, why: str) -> None:
    bad = bytearray(FRAMES[1])
    bad[place : place + len(content)] = content
    recording = parse(FRAMES[0] + summed(bad) + FRAMES[2])
    assert numbers(recording) == [0, 2]
    (loss,) = recording.losses
    assert (loss.offset, loss.length) == (len(FRAMES[0]), len(FRAMES[1]))
    assert any(part in loss.why for part in why.split("|")), loss.why


def test_marks_and_lengths_without_end_cost_time_in_proportion_to_the_file() -> None:
    """Each offset starts a header that claims up to 64 kB: separate sums would take hours."""
    hostile = (b"\x7f\x7f\xf0\xff" + b"\x01" * 12) * 100_000
    for data in (hostile, b"\x7f" * 2_000_000):
        recording = parse(FRAMES[0] + data + FRAMES[1])
        assert numbers(recording) == [0, 1]
        assert recording.lost_bytes == len(data)


def test_losses_without_end_are_counted_and_not_all_kept() -> None:
    data = FRAMES[0] + b"".join(b"x" + frame for frame in FRAMES[1:]) + b"yz"
    recording = reader.parse(data, source="test", max_losses=3)
    assert numbers(recording) == [0, 1, 2, 3, 4]
    assert (len(recording.losses), recording.lost_places, recording.lost_bytes) == (3, 5, 6)


def test_files_that_cannot_be_read_are_refused_by_name(tmp_path: Path) -> None:
    path = tmp_path / "dive.PD0"
    for given_path, why in ((path, "no such file"), (tmp_path, "is a folder")):
        with pytest.raises(ConfigError, match=why) as error:
            reader.read(given_path)
        assert str(given_path) in str(error.value)
    path.write_bytes(FILE)
    assert numbers(reader.read(path)) == [0, 1, 2, 3, 4]
    with path.open("r+b") as file:  # sparse: it needs no space on the disk
        file.truncate(reader.MAX_FILE_BYTES + 1)
    with pytest.raises(ConfigError, match=f"has {reader.MAX_FILE_BYTES + 1} bytes: at most"):
        reader.read(path)


def test_another_instrument_has_another_head_and_other_cells_are_another_setup():
    leader = parse(written(HEADS[0], still(HEADS[0]))).ensembles[0].settings
    moved = leader._replace(first_cell_m=leader.first_cell_m + 0.04 * leader.cell_m)
    assert leader.setup == moved.setup
    assert leader.setup != leader._replace(pings=leader.pings + 1).setup
    assert leader.same_instrument(leader._replace(cells=leader.cells + 5, cell_m=0.5, pings=1))
    assert not leader.same_instrument(leader._replace(frequency_kHz=75))
    assert not leader.same_instrument(leader._replace(upward=not leader.upward))
