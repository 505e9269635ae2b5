"""Export as tables: each number bit for bit, under its name on the bus, in the file of its key."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pyarrow.parquet as pq
import pytest

from ltv_mpc.messages import AdcpPing, Applied, Estimate, ImuSamples, Message, Plan
from services.bus.topics import key_of
from services.bus.wire import Header, to_map
from services.recording import export
from services.recording.export import Format
from tests.services.bus.messages import EXAMPLES
from tests.services.recording.recordings import foreign, write

T_NS = 1_500_000_000


def example(kind: type[Message], **fields: Any) -> Message:
    return msgspec.structs.replace(next(e for e in EXAMPLES[::-1] if isinstance(e, kind)), **fields)


def rows(folder: Path, name: str) -> list[dict[str, str]]:
    with (folder / name).open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def exported(tmp_path: Path, form: Format, *signals: tuple[str, Message]) -> export.ExportResult:
    messages = [(node, signal, 1, k, T_NS + k) for k, (node, signal) in enumerate(signals)]
    return export.export([write(tmp_path / "run.mcap", messages)], tmp_path, form)


def leaves(value: Any, name: str) -> dict[str, Any]:
    """Return every scalar of a message's map by column name, by an independent rule: join by "." and "_"."""
    if isinstance(value, dict) and value:
        return {k: v for key, inner in value.items() for k, v in leaves(inner, f"{name}.{key}".lstrip(".")).items()}
    if isinstance(value, list) and value and not any(isinstance(x, dict | str) for x in value):
        return {k: v for i, inner in enumerate(value) for k, v in leaves(inner, f"{name}_{i}").items()}
    return {name: value}


LATEST = {type(signal): signal for signal in EXAMPLES if not isinstance(signal, ImuSamples)}
"""One message of each type, so that every list has one length."""


@pytest.mark.parametrize("form", ["csv", "parquet"])
def test_every_kind_of_message_comes_back_bit_for_bit_with_its_types(form: Format, tmp_path: Path) -> None:
    epochs = {kind: getattr(signal, "epoch", 1) for kind, signal in LATEST.items()}
    messages = [("plant", signal, epochs[kind], 0, T_NS) for kind, signal in LATEST.items()]
    result = export.export([write(tmp_path / "run.mcap", messages)], tmp_path, form)
    files = {file.key: file.file for file in result.files}
    assert len(files) == len(LATEST)
    for kind, signal in LATEST.items():
        name = files[key_of(kind, "plant")]
        (row,) = rows(tmp_path, name) if form == "csv" else pq.read_table(tmp_path / name).to_pylist()
        travels = to_map(signal, Header(epoch=epochs[kind], sequence=0))
        expected = leaves(json.loads(json.dumps(travels)), "")
        times = {"published_s": T_NS / 1e9, "published_ns": T_NS}
        if isinstance(expected.get("t_ns"), int):
            times["t_s"] = expected["t_ns"] / 1e9
        expected = times | expected
        assert set(row) == set(expected)
        for column, value in expected.items():
            got = said(row[column], value)
            assert got == value, (name, column)
            assert type(got) is type(value), (name, column)


def said(cell: Any, like: Any) -> Any:
    """Return the value of a cell: text as it is; in CSV everything else, and structures, as JSON or empty."""
    if isinstance(like, str) or not isinstance(cell, str):
        return cell
    return json.loads(cell) if cell else None


@pytest.mark.parametrize("form", ["csv", "parquet"])
def test_each_inertial_sample_has_a_row_with_the_header_of_its_message(form: Format, tmp_path: Path) -> None:
    two = example(ImuSamples)
    assert isinstance(two, ImuSamples)
    exported(tmp_path, form, ("sensors", two), ("sensors", two))
    name = f"sensor-imu.{form}"
    table = rows(tmp_path, name) if form == "csv" else pq.read_table(tmp_path / name).to_pylist()
    assert [(int(row["sequence"]), int(row["t_ns"])) for row in table] == [
        (sequence, sample.t_ns) for sequence in (0, 1) for sample in two.samples
    ]
    assert [float(row["specific_force_mps2_2"]) for row in table] == 2 * [x.specific_force_mps2[2] for x in two.samples]


def test_a_single_inertial_sample_of_an_older_recording_is_a_row_and_no_list_of_samples_is_counted(tmp_path) -> None:
    path = foreign(tmp_path / "run.mcap", "sensor/imu", b'{"t_ns": 5}', b'{"samples": 3}', b'{"samples": [1]}')
    assert export.export([path], tmp_path, "csv").unreadable == 2
    assert [row["t_ns"] for row in rows(tmp_path, "sensor-imu.csv")] == ["5"]


@pytest.mark.parametrize("form", ["csv", "parquet"])
def test_a_list_of_changing_length_has_empty_cells_beyond_its_end(form: Format, tmp_path: Path) -> None:
    pings = [
        ("sensors", AdcpPing(t_ns=k, range_m=np.arange(1.0, cells), beam_velocity_mps=np.full((4, cells - 1), np.nan)))
        for k, cells in enumerate((3, 4))
    ]
    exported(tmp_path, form, *pings)
    name = f"sensor-adcp.{form}"
    table = rows(tmp_path, name) if form == "csv" else pq.read_table(tmp_path / name).to_pylist()
    assert [said(row["range_m_2"], 0.0) for row in table] == [None, 3.0]
    assert [said(row["range_m_1"], 0.0) for row in table] == [2.0, 2.0]
    assert {row[f"beam_velocity_mps_{beam}_2"] for row in table for beam in range(4)} <= {None, ""}


def test_what_is_null_in_one_message_and_there_in_another_is_an_empty_cell(tmp_path: Path) -> None:
    exported(tmp_path, "csv", ("e", Estimate.at_rest()), ("e", example(Estimate)))
    first, second = rows(tmp_path, "estimate.csv")
    assert "current" not in first
    assert "covariance" not in first
    assert (first["depth_m"], first["current.depth_m_69"], first["covariance_5_5"]) == ("", "", "")
    assert (second["depth_m"], second["current.depth_m_69"], second["covariance_5_5"]) == ("20.0", "69.0", "1e-09")


def test_knots_stay_integers_beyond_what_a_float_holds(tmp_path: Path) -> None:
    at = np.array([2**53 + 1, 2**53 + 3])
    plan = example(Plan, t_ns=at, thrust_N=np.zeros((2, 3)), states=np.zeros((2, 6)))
    exported(tmp_path, "csv", ("controller", plan))
    exported(tmp_path, "parquet", ("controller", plan))
    assert rows(tmp_path, "plan.csv")[0]["t_ns_0"] == str(2**53 + 1)
    assert pq.read_table(tmp_path / "plan.parquet")["t_ns_1"].to_pylist() == [2**53 + 3]


@pytest.mark.parametrize("form", ["csv", "parquet"])
def test_messages_of_any_form_make_a_table_and_what_is_none_is_counted(form: Format, tmp_path: Path) -> None:
    path = foreign(
        tmp_path / "run.mcap",
        "any",
        *(b'{"a":1,"b":[1,[2]],"c":{"d":null},"e":[]}', b'{"a":"x","b":null,"c":{},"e":[1]}', b'{"a":[1.5]}', b"{}"),
        *(b"[1]", b"null", b"{", b'{"a":"\xff"}', b"[" * 10_000),
        *(
            b'{"n":1%s,"m":[1%s,0.5]}' % (b"0" * 30, b"0" * 30),
            b'{"n":true,"m":[2,null]}',
            b'{"big":[1%s]}' % (b"0" * 400),
        ),
    )
    result = export.export([path], tmp_path, form)
    assert result.unreadable == 5
    (file,) = result.files
    assert file.rows == 7
    table: list[dict[str, Any]] = (
        rows(tmp_path, file.file) if form == "csv" else pq.read_table(tmp_path / file.file).to_pylist()
    )
    assert [json.loads(row["a"]) for row in table[:2]] == [1, "x"]
    assert float(table[2]["a_0"]) == 1.5
    assert float(table[0]["b_1_0"]) == 2


def test_a_key_cannot_lead_out_of_the_folder_nor_two_keys_into_one_file(tmp_path: Path) -> None:
    keys = ("../../evil", "/etc/x", "..", "a b", "", "a/b", "A-b", "a-b")
    parts = [foreign(tmp_path / f"{i}.mcap", key, b'{"x":1}') for i, key in enumerate(keys)]
    out = tmp_path / "out"
    out.mkdir()
    names = [file.file for file in export.export(parts, out, "csv").files]
    assert sorted(path.name for path in out.iterdir()) == sorted(names)
    assert {"evil.csv", "etc-x.csv", "key.csv", "a-b-2.csv"} <= set(names)
    assert len({name.lower() for name in names}) == len(keys)


def test_rows_beyond_a_batch_follow_in_order(tmp_path: Path) -> None:
    rows = 2 * export.BATCH_ROWS + 2
    exported(tmp_path, "parquet", *[("plant", example(Applied, t_ns=k)) for k in range(rows)])
    table = pq.read_table(tmp_path / "applied.parquet")
    assert table["t_ns"].to_pylist() == list(range(rows))
    assert table.schema.metadata[b"ltv_mpc.message"] == b"Applied"
