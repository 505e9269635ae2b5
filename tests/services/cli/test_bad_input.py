"""Bad input is rejected before anything starts: exit code 2, one line with file, field, value and bound, no files."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from ltv_mpc.vehicle import parameters
from services.cli.app import run

CSV = "depth_m,v_north_mps,u_east_mps\n"
PAPER = (Path(parameters.__file__).parent / "files" / "paper.toml").read_text()

FILES: dict[str, str | bytes] = {
    "empty.toml": "",
    "empty.csv": "",
    "binary.toml": bytes(range(256)),
    "binary.csv": bytes(range(256)),
    "broken.toml": "title = ",
    "formulation.toml": 'formulation = "sparse"\n',
    "scenario-unknown.toml": 'title = "x"\n[water]\nsd = 1.0\n',
    "scenario-negative.toml": 'title = "x"\n[water]\nsd_mps = -0.04\n',
    "scenario-nan.toml": 'title = "x"\n[run]\nduration_s = nan\n',
    "scenario-inf.toml": 'title = "x"\n[run]\nspeed = inf\n',
    "scenario-untitled.toml": "[run]\nseed = 1\n",
    "scenario-vehicle.toml": 'title = "x"\nvehicle = "vehicles/none.toml"\n',
    "scenario-measured.toml": 'title = "x"\n[water]\nkind = "measured"\n',
    "vehicle-unknown.toml": PAPER.replace("arm_m", "arm_meters", 1),
    "vehicle-slew.toml": PAPER.replace("slew_N_per_s = 100.0", "slew_N_per_s = 0.0", 1),
    "vehicle-mass.toml": PAPER.replace("mass_kg = 500.0", 'mass_kg = "heavy"', 1),
    "vehicle-point.toml": PAPER + "[reference_point]\nforward_m = 0.5\n",
    "vehicle-far.toml": PAPER + "[reference_point]\nforward_m = 500\n",
    "sensors-rate.toml": 'name = "x"\ndescription = ""\nlatitude_rad = 0.0\n[imu]\nperiod_ns = 0\n',
    "reference-kind.toml": 'kind = "square"\n',
    "reference-rate.toml": 'kind = "hold"\ndescent_rate_mps = 0.0\n',
    "columns.csv": "depth_m,v_north_mps\n1,0\n",
    "unsorted.csv": CSV + "1,0,0\n3,0,0\n2,0,0\n",
    "nan.csv": CSV + "1,nan,0\n",
    "inf.csv": CSV + "1,0,inf\n",
    "words.csv": CSV + "1,fast,0\n",
    "rows.csv": CSV,
    "profile.csv": CSV + "1,0,0\n",
    "prior-sd.csv": "depth_m,v_north_mps,u_east_mps,sd_mps,sd_common_mps\n1,0,0,-0.1,0\n",
    "prior-common.csv": "depth_m,v_north_mps,u_east_mps,sd_mps,sd_common_mps\n1,0,0,0.1,0.2\n",
    "scenario-prior.toml": 'title = "x"\n[estimator]\nwater_prior = "water/none.csv"\n',
    "estimator-prior.toml": 'water_prior = "prior-sd.csv"\n',
    "sensors-base.toml": 'base = "good"\n',
    "sensors-upon.toml": 'base = "realistic"\n[imu]\nperiod_ns = 0\n',
    "controller-period.toml": "horizon_s = 1.0\nperiod_s = 30.0\n",
    "boss.json5": "{mode: 'boss'}",
    "cut.json5": "{mode:\n",
    "empty-table.toml": "[settings]\n",
    "run.mcap": "",
}

CASES = [
    # --- scenario -------------------------------------------------------------------------------------------------
    ("sim decsent", 'scenario "decsent": no shipped name; shipped: demo, descent, hover; did you mean "descent"?'),
    ("sim none.toml", "scenario none.toml: no such file"),
    ("sim folder/", "scenario folder: is a folder"),
    ("sim ./folder", "scenario folder: is a folder"),
    ("sim empty.toml", "scenario empty.toml: is empty"),
    ("sim binary.toml", "scenario binary.toml: is not UTF-8 text"),
    ("sim broken.toml", "scenario broken.toml: is not valid TOML: Invalid value (at "),
    ("sim scenario-unknown.toml", 'scenario-unknown.toml: unknown key "sd" in [water]; did you mean "sd_mps"?'),
    ("sim scenario-negative.toml", "scenario-negative.toml: [water] sd_mps = -0.04: must be >= 0 and <= 5"),
    ("sim scenario-nan.toml", "scenario-nan.toml: [run] duration_s = nan: must be finite"),
    ("sim scenario-inf.toml", "scenario-inf.toml: [run] speed = inf: must be finite"),
    ("sim scenario-untitled.toml", 'scenario-untitled.toml: key "title" is missing'),
    ("sim scenario-vehicle.toml", "vehicle vehicles/none.toml: no such file"),
    ("sim scenario-measured.toml", '[water] file = "": must name a currents CSV where kind = "measured"'),
    # --- the files it names ---------------------------------------------------------------------------------------
    (
        "sim --vehicle papr",
        'vehicle "papr": no shipped name; shipped: bluerobotics-boat, low-yaw, paper, surface, weak-reverse; '
        'did you mean "paper"?',
    ),
    ("sim --vehicle vehicle-unknown.toml", 'unknown key "arm_meters" in [thruster.port]; did you mean "arm_m"?'),
    ("sim --vehicle vehicle-slew.toml", "[thruster.port] slew_N_per_s = 0.0: must be > 0 and <= 1000000"),
    ("sim --vehicle vehicle-mass.toml", 'vehicle-mass.toml: [surge] mass_kg = "heavy": must be a number > 0'),
    ("sim --vehicle folder/", "vehicle folder: is a folder"),
    ("sim --sensors sensors-rate.toml", "sensors-rate.toml: [imu] period_ns = 0: must be >= 1000000 and <= "),
    ("sim --sensors good", 'sensors "good": no shipped name; shipped: paper, realistic'),
    ("sim --reference reference-kind.toml", 'reference-kind.toml: kind = "square": must be "point" or "hold" or'),
    ("sim --reference reference-rate.toml", "descent_rate_mps = 0.0: must be > 0 and <= 10"),
    ("sim --currents none.csv", "currents none.csv: no such file"),
    ("sim --currents folder", "currents folder: is a folder"),
    ("sim --currents /dev/zero", "currents /dev/zero: is not a regular file"),
    ("sim --currents empty.csv", "currents empty.csv: is empty"),
    ("sim --currents binary.csv", "currents binary.csv: is not UTF-8 text"),
    ("sim --currents columns.csv", "missing column u_east_mps"),
    ("sim --currents unsorted.csv", "line 4 depth_m = 2.0: must be"),
    ("sim --currents nan.csv", "line 2 v_north_mps = "),
    ("sim --currents inf.csv", "line 2 u_east_mps = "),
    ("sim --currents words.csv", 'line 2 v_north_mps = "fast": must be a number'),
    ("sim --currents rows.csv", "currents rows.csv: no row"),
    ("sim --water-prior none.csv", "currents none.csv: no such file"),
    ("sim --water-prior profile.csv", "currents profile.csv: line 1: missing column sd_mps: a prior needs it"),
    ("sim --water-prior prior-sd.csv", "currents prior-sd.csv: line 2 sd_mps = -0.1: must be >= 0 and <= 10 m/s"),
    ("sim --water-prior prior-common.csv", "line 2 sd_common_mps = 0.2: must be <= sd_mps = 0.1"),
    ("sim --set estimator.water_prior=folder", "currents folder: is a folder"),
    ("sim scenario-prior.toml", "currents water/none.csv: no such file"),
    ("sim --water-prior profile.csv --perfect-state", "option --water-prior: cannot act together with --perfect-state"),
    ("sim --sensors sensors-base.toml", 'sensors-base.toml: base = "good": no shipped name; shipped: paper, realistic'),
    ("sim --sensors sensors-upon.toml", "sensors-upon.toml: [imu] period_ns = 0: must be >= 1000000"),
    # --- options and --set ----------------------------------------------------------------------------------------
    ("sim --duration-s 0", "option --duration-s: [run] duration_s = 0: must be > 0 and <= 1000000"),
    ("sim --duration-s nan", "option --duration-s: [run] duration_s = nan: must be finite"),
    ("sim --duration-s ten", 'option --duration-s: [run] duration_s = "ten": must be a number > 0'),
    ("sim --horizon-s -1", "option --horizon-s: [controller] horizon_s = -1: must be >= 0.3 and <= 120"),
    ("sim --horizon-s 0", "option --horizon-s: [controller] horizon_s = 0: must be >= 0.3"),
    ("sim --speed 0", "option --speed: [run] speed = 0: must be >= 0.01"),
    ("sim --speed inf", "option --speed: [run] speed = inf: must be finite"),
    ("sim --seed -1", "option --seed: [run] seed = -1: must be >= 0"),
    ("sim --seed 1.5", "option --seed: [run] seed = 1.5: must be an integer >= 0"),
    ("sim --compute-delay-s -0.1", "option --compute-delay-s: [run] compute_delay_s = -0.1: must be >= 0"),
    ("sim --surface-time-s 0", "option --surface-time-s: [run] surface_time_s = 0: must be >= 1"),
    ("sim --lockstep --speed 5", "option --speed: cannot act together with --lockstep"),
    ("sim --lockstep --set run.speed=5", "option --set: run.speed: cannot act together with --lockstep"),
    ("sim --set water.sd=1", 'option --set: "water.sd": unknown key; did you mean "water.sd_mps"?'),
    ("sim --set controller.formulation=sparse", 'option --set: "controller.formulation": unknown key'),
    ("controller --settings formulation.toml", 'formulation.toml: unknown key "formulation"'),
    ("sim --set horizon_s=5", 'option --set: "horizon_s": unknown key; did you mean "controller.horizon_s"?'),
    ("sim --set water", 'option --set: "water": must be KEY=VALUE'),
    ("sim --set water=3", 'option --set: "water": is a table: set one of water.kind, '),
    ("sim --set water.sd_mps=", "option --set: [water] sd_mps"),
    ("sim --set water.kind=makrov", 'option --set: [water] kind = "makrov": must be "markov" or "measured"'),
    ("sim --set controller.solver=ospq", 'solver = "ospq": '),
    ("sim --set controller.period_s=20", "[controller] period_s = 20.0: must be <= horizon_s = 13.8"),
    ("sim --set estimator.cell_m=0.01", "[estimator] cell_m = 0.01: must be <= deepest_m = 70, and at least 0.14"),
    ("sim --out full", 'option --out: "full": '),
    ("localise none.pd0 --out full", 'option --out: "full": is not empty'),
    ("localise binary.csv --out fresh", "binary.csv"),
    ("sim --out rows.csv", 'option --out: "rows.csv": '),
    ("sim --out rows.csv/below", 'option --out: "rows.csv/below": '),
    # --- the command line itself ----------------------------------------------------------------------------------
    ("smi", 'ltv-mpc: command "smi": unknown; did you mean "sim"?'),
    ("log inof", 'ltv-mpc: command "inof": unknown; did you mean "info"?'),
    ("nonsense", 'ltv-mpc: command "nonsense": unknown; `ltv-mpc --help` lists the commands'),
    ("--verson", 'ltv-mpc: option --verson: unknown; did you mean "--version"?'),
    ("sim --horizonn 5", 'ltv-mpc: option --horizonn: unknown; did you mean "--horizon-s"?'),
    ("sim -speed=5", 'ltv-mpc: option -speed: unknown; did you mean "--speed"?'),
    ("doctor --bogus", "ltv-mpc: option --bogus: unknown; `ltv-mpc doctor --help` describes the command"),
    ("sim --seed", "ltv-mpc: option --seed: needs a value, N; `ltv-mpc sim --help` describes the command"),
    ("sim --json=1", 'ltv-mpc: option --json: "1": takes no value; '),
    ("sim descent hover", 'ltv-mpc: argument: "hover": is not expected; `ltv-mpc sim` takes: SCENARIO'),
    ("doctor now", 'ltv-mpc: argument: "now": is not expected; `ltv-mpc doctor` takes: none'),
    ("campaign", "ltv-mpc: argument FILE.toml: is missing; `ltv-mpc campaign --help` describes the command"),
    (
        "log export --format parqet x",
        'option --format: "parqet": must be one of csv, parquet; did you mean "parq',
    ),
    ("certs new --ros-domain x", 'ltv-mpc: option --ros-domain: "x": must be an integer >= 0 and <= 232'),
    ("topics plann", 'topic "plann": is not a topic; did you mean "plan"?'),
    ("profile --horizons 5,x", 'option --horizons: "x": must be numbers of stages of 0.3 s'),
    ("profile --horizons 5,,", "option --horizons"),
    ("profile --cycles 0", "ltv-mpc: option --cycles: 0: must be >= 10 and <= 100000"),
    ("profile --cycles 1.5", "ltv-mpc: option --cycles: 1.5: must be an integer >= 10 and <= 100000"),
    # --- a recording that was never begun -------------------------------------------------------------------------
    *(
        (f"{command} run.mcap", "ltv-mpc: recording run.mcap: no recording: 0 bytes")
        for command in (
            *("report", "replay", "log info", "log recover", "log export"),
            *("vehicle identify", "profile --run"),
        )
    ),
    ("report .", "ltv-mpc: recording run.mcap: no recording: 0 bytes"),
    # --- one process each -----------------------------------------------------------------------------------------
    ("plant none.toml", "scenario none.toml: no such file"),
    ("sensors decsent", 'scenario "decsent": no shipped name'),
    ("recorder scenario-nan.toml", "[run] duration_s = nan: must be finite"),
    ("controller --vehicle vehicle-unknown.toml", 'unknown key "arm_meters" in [thruster.port]; did you mean "arm_m"?'),
    ("controller --vehicle vehicle-far.toml", "[reference_point] forward_m = 500: must be >= -100 and <= 100"),
    ("estimator --vehicle vehicle-point.toml", "[reference_point]: must be 0 or left out: this estimator publishes"),
    ("controller --settings scenario-negative.toml", 'unknown key "title"'),
    ("controller --settings controller-period.toml", "period_s = 30.0: must be <= horizon_s = 1: a plan lasts until"),
    ("controller --reference reference-kind.toml", 'kind = "square": must be "point" or "hold" or'),
    ("estimator --sensors sensors-rate.toml", "[imu] period_ns = 0: must be >= 1000000"),
    ("estimator --sensors sensors-upon.toml", "[imu] period_ns = 0: must be >= 1000000"),
    ("estimator --settings empty.toml", "is empty"),
    ("estimator --settings estimator-prior.toml", "prior-sd.csv: line 2 sd_mps = -0.1: must be >= 0"),
    ("plant scenario-prior.toml", "currents water/none.csv: no such file"),
    ("router --connect nowhere", 'option --connect: "nowhere": must be PROTOCOL/ADDRESS'),
    ("router --listen tcp/", 'option --listen: "tcp/": must be PROTOCOL/ADDRESS'),
    ("router --listen tcp/127.0.0.1:99999", '"tcp/127.0.0.1:99999": must be tcp/HOST:PORT, PORT from 1 to 65535'),
    ("router --listen udp/127.0.0.1:0", 'option --listen: "udp/127.0.0.1:0": must be udp/HOST:PORT'),
    ("router --listen tcp/7447", 'option --listen: "tcp/7447": must be tcp/HOST:PORT'),
    ("estimator --connect foo/bar", 'option --connect: "foo/bar": the protocol must be one of tcp, udp, '),
    ("router --config rows.csv", 'option --config: "rows.csv": Zenoh rejects the configuration: Unsupported file'),
    (
        "router --config boss.json5",
        '"boss.json5": Zenoh rejects the configuration: JSON error: Message { msg: "unknown',
    ),
    ("router --config cut.json5", 'option --config: "cut.json5": Zenoh rejects the configuration: '),
    ("router --config empty-table.toml", '"empty-table.toml": Zenoh rejects the configuration: TOML'),
    ("router --mode boss", 'mode = "boss": must be "client" or "peer" or "router"'),
    ("router --config none.json5", "none.json5: no such file"),
    ("router --namespace a*b", 'option --namespace: "a*b": must be names joined by /'),
]


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for name, content in FILES.items():
        (tmp_path / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    (tmp_path / "folder").mkdir()
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine.txt").write_text("keep")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize(("line", "says"), CASES, ids=[line for line, _ in CASES])
def test_bad_input_is_refused_in_one_line(
    line: str, says: str, bench: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = sorted(bench.rglob("*"))
    assert run(line.split()) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert says in err
    assert err.startswith("ltv-mpc")
    assert err.count("\n") == 1
    assert err.endswith("\n")
    assert ".rs" not in err
    assert sorted(bench.rglob("*")) == before


@pytest.mark.parametrize("line", ["sim scenario-negative.toml", "controller --vehicle vehicle-mass.toml", "smi"])
def test_a_process_exits_with_2_without_a_traceback(line: str, bench: Path) -> None:
    command = [sys.executable, "-P", "-m", "services.cli", *line.split()]
    result = subprocess.run(command, cwd=bench, capture_output=True, text=True, timeout=60, check=False)
    assert result.returncode == 2
    assert result.stdout == ""
    assert result.stderr.count("\n") == 1
    assert "Traceback" not in result.stderr


def test_a_name_that_holds_line_breaks_still_makes_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["sim", "a\nb.toml", "--set", "x\ny=1"]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert run(["sim", "--set", "x\ny=1"]) == 2
    assert capsys.readouterr().err.count("\n") == 1
