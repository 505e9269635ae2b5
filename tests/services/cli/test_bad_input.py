"""Bad input is rejected before anything starts: exit code 2, one line with file, field, value and bound, no files."""

from __future__ import annotations

from pathlib import Path

import pytest

from ltv_mpc.vehicle import parameters
from services.cli.app import main, run

CSV = "depth_m,v_north_mps,u_east_mps\n"
PAPER = (Path(parameters.__file__).parent / "files" / "paper.toml").read_text()

FILES: dict[str, str | bytes] = {
    "empty.toml": "",
    "binary.csv": bytes(range(256)),
    "broken.toml": "title = ",
    "scenario-unknown.toml": 'title = "x"\n[water]\nsd = 1.0\n',
    "scenario-negative.toml": 'title = "x"\n[water]\nsd_mps = -0.04\n',
    "scenario-nan.toml": 'title = "x"\n[run]\nduration_s = nan\n',
    "scenario-untitled.toml": "[run]\nseed = 1\n",
    "scenario-vehicle.toml": 'title = "x"\nvehicle = "vehicles/none.toml"\n',
    "scenario-measured.toml": 'title = "x"\n[water]\nkind = "measured"\n',
    "vehicle-unknown.toml": PAPER.replace("arm_m", "arm_meters", 1),
    "vehicle-mass.toml": PAPER.replace("mass_kg = 500.0", 'mass_kg = "heavy"', 1),
    "vehicle-point.toml": PAPER + "[reference_point]\nforward_m = 0.5\n",
    "vehicle-far.toml": PAPER + "[reference_point]\nforward_m = 500\n",
    "sensors-rate.toml": 'name = "x"\ndescription = ""\nlatitude_rad = 0.0\n[imu]\nperiod_ns = 0\n',
    "reference-kind.toml": 'kind = "square"\n',
    "columns.csv": "depth_m,v_north_mps\n1,0\n",
    "rows.csv": CSV,
    "profile.csv": CSV + "1,0,0\n",
    "prior-sd.csv": "depth_m,v_north_mps,u_east_mps,sd_mps,sd_common_mps\n1,0,0,-0.1,0\n",
    "scenario-prior.toml": 'title = "x"\n[estimator]\nwater_prior = "water/none.csv"\n',
    "estimator-prior.toml": 'water_prior = "prior-sd.csv"\n',
    "estimator-cells.toml": "cell_m = 0.1\n",
    "controller-period.toml": "horizon_s = 1.0\nperiod_s = 30.0\n",
    "boss.json5": "{mode: 'boss'}",
    "run.mcap": "",
}

CASES = [
    # --- scenario -------------------------------------------------------------------------------------------------
    (
        "sim decsent",
        'scenario "decsent": no shipped name; shipped: demo, descent, hover, paper-2.5s, paper-5s, paper-no-control; '
        'did you mean "descent"?',
    ),
    ("sim folder/", "scenario folder: is a folder"),
    ("sim empty.toml", "scenario empty.toml: is empty"),
    ("sim broken.toml", "scenario broken.toml: is not valid TOML: Invalid value (at "),
    ("sim scenario-unknown.toml", 'scenario-unknown.toml: unknown key "sd" in [water]; did you mean "sd_mps"?'),
    ("sim scenario-negative.toml", "scenario-negative.toml: [water] sd_mps = -0.04: must be >= 0"),
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
    ("sim --sensors good", 'sensors "good": no shipped name; shipped: paper, realistic'),
    ("sim --reference reference-kind.toml", 'reference-kind.toml: kind = "square": must be "point" or "hold" or'),
    ("sim --currents none.csv", "currents none.csv: no such file"),
    ("sim --currents columns.csv", "missing column u_east_mps"),
    ("sim --water-prior profile.csv", "currents profile.csv: line 1: missing column sd_mps: a prior needs it"),
    ("sim --water-prior profile.csv --perfect-state", "option --water-prior: cannot act together with --perfect-state"),
    # --- options and --set ----------------------------------------------------------------------------------------
    ("sim --duration-s 0", "option --duration-s: [run] duration_s = 0: must be > 0 and <= 1000000"),
    ("sim --duration-s ten", 'option --duration-s: [run] duration_s = "ten": must be a number > 0'),
    ("sim --seed 1.5", "option --seed: [run] seed = 1.5: must be an integer >= 0"),
    ("sim --lockstep --speed 5", "option --speed: cannot act together with --lockstep"),
    ("sim --lockstep --set run.speed=5", "option --set: run.speed: cannot act together with --lockstep"),
    ("sim --set water.sd=1", 'option --set: "water.sd": unknown key; did you mean "water.sd_mps"?'),
    ("sim --set horizon_s=5", 'option --set: "horizon_s": unknown key; did you mean "controller.horizon_s"?'),
    ("sim --set water", 'option --set: "water": must be KEY=VALUE'),
    ("sim --set water=3", 'option --set: "water": is a table: set one of water.kind, '),
    ("sim --set water.kind=makrov", 'option --set: [water] kind = "makrov": must be "markov" or "measured"'),
    ("sim --set controller.solver=ospq", 'solver = "ospq": '),
    ("sim --set controller.period_s=20", "[controller] period_s = 20.0: must be <= horizon_s = 13.8"),
    ("sim --set estimator.cell_m=0.01", "[estimator] cell_m = 0.01: must be <= deepest_m = 70, and at least 0.14"),
    ("sim --out full", 'option --out: "full": '),
    ("localise none.pd0 --out full", 'option --out: "full": is not empty'),
    ("localise binary.csv --out fresh", "binary.csv"),
    ("sim --out rows.csv", 'option --out: "rows.csv": '),
    # --- the command line itself ----------------------------------------------------------------------------------
    ("smi", 'ltv-mpc: command "smi": unknown; did you mean "sim"?'),
    ("--verson", 'ltv-mpc: option --verson: unknown; did you mean "--version"?'),
    ("sim --horizonn 5", 'ltv-mpc: option --horizonn: unknown; did you mean "--horizon-s"?'),
    ("doctor --bogus", "ltv-mpc: option --bogus: unknown; `ltv-mpc doctor --help` describes the command"),
    ("sim --seed", "ltv-mpc: option --seed: needs a value, N; `ltv-mpc sim --help` describes the command"),
    ("sim --json=1", 'ltv-mpc: option --json: "1": takes no value; '),
    ("sim descent hover", 'ltv-mpc: argument: "hover": is not expected; `ltv-mpc sim` takes: SCENARIO'),
    ("campaign", "ltv-mpc: argument FILE.toml: is missing; `ltv-mpc campaign --help` describes the command"),
    ("log export --format parqet x", 'option --format: "parqet": must be one of csv, parquet; did you mean "parq'),
    ("certs new --ros-domain x", 'ltv-mpc: option --ros-domain: "x": must be an integer >= 0 and <= 232'),
    ("topics plann", 'topic "plann": is not a topic; did you mean "plan"?'),
    ("profile --horizons 5,x", 'option --horizons: "x": must be numbers of stages of 0.3 s'),
    ("profile --cycles 0", "ltv-mpc: option --cycles: 0: must be >= 10 and <= 100000"),
    # --- a recording that was never begun -------------------------------------------------------------------------
    *(
        (f"{command} run.mcap", "ltv-mpc: recording run.mcap: no recording: 0 bytes")
        for command in (
            *("report", "replay", "log info", "log recover", "log export"),
            *("vehicle identify", "profile --run"),
        )
    ),
    # --- one process each -----------------------------------------------------------------------------------------
    ("plant none.toml", "scenario none.toml: no such file"),
    ("recorder scenario-nan.toml", "[run] duration_s = nan: must be finite"),
    ("controller --vehicle vehicle-far.toml", "[reference_point] forward_m = 500: must be >= -100 and <= 100"),
    ("estimator --vehicle vehicle-point.toml", "[reference_point]: must be 0 or left out: this estimator publishes"),
    ("controller --settings controller-period.toml", "period_s = 30.0: must be <= horizon_s = 1: a plan lasts until"),
    ("estimator --sensors sensors-rate.toml", "[imu] period_ns = 0: must be >= 1000000"),
    ("estimator --settings estimator-cells.toml", "estimator-cells.toml: cell_m = 0.1: must be <= deepest_m = 70"),
    ("estimator --settings estimator-prior.toml", "prior-sd.csv: line 2 sd_mps = -0.1: must be >= 0"),
    ("plant scenario-prior.toml", "currents water/none.csv: no such file"),
    ("router --connect nowhere", 'option --connect: "nowhere": must be PROTOCOL/ADDRESS'),
    ("router --listen tcp/127.0.0.1:99999", '"tcp/127.0.0.1:99999": must be tcp/HOST:PORT, PORT from 1 to 65535'),
    ("router --listen tcp/7447", 'option --listen: "tcp/7447": must be tcp/HOST:PORT'),
    ("router --config rows.csv", 'option --config: "rows.csv": Zenoh rejects the configuration: Unsupported file'),
    (
        "router --config boss.json5",
        '"boss.json5": Zenoh rejects the configuration: JSON error: Message { msg: "unknown',
    ),
    ("router --mode boss", 'option --mode: "boss": must be one of client, peer, router'),
    ("router --config none.json5", "none.json5: no such file"),
    ("router --namespace a*b", 'option --namespace: "a*b": must be names joined by /'),
    ("controller --resume-armed", "option --resume-armed: needs --state DIR"),
    ("controller --rate-hz 0", "rate-hz"),
    ("controller --rate-hz nan", "rate-hz"),
    ("controller --rate-hz 0.1 --horizon-s 5", "period_s = 10.0: must be <= horizon_s = 5"),
    ("controller --metrics 65536", "metrics"),
    ("controller --input-delay-s -1", "input-delay-s"),
    ("controller --own-clock", "--own-clock"),
    ("ctl go", 'argument ACTION: "go": must be one of arm, disarm'),
    ("ctl arme", 'did you mean "arm"?'),
    ("ctl follow", "needs a reference"),
    ("ctl fence", "needs a fence"),
    ("ctl fence nowhere.toml", "fence nowhere.toml: no such file"),
    ("ctl arm hover", "takes no file or name"),
    ("ctl source GNSS", 'argument NAME: "GNSS": must be'),
    ("ctl hold --force", "only arm takes it"),
    ("ctl follow nowhere.toml", "reference nowhere.toml: no such file"),
    # --- tools ----------------------------------------------------------------------------------------------------
    ("dive plan --reference square --depth-m 5 --out fresh", "--depth-m"),
    ("dive plan --fixes 1,x --out fresh", "--fixes"),
    ("dive plan --fixes 0 --out fresh", "from 1 to 3600"),
    ("dive plan --sensors perfect --out fresh", "perfect"),
    ("dive plan --reference nowhere --out fresh", "nowhere"),
    ("dive plan --against no-such-run --out fresh", "no-such-run"),
    ("dive plan --duration-s 5 --out fresh", "--duration-s"),
    ("dive plan --depth-m 1001 --out fresh", "--depth-m"),
    ("profile --solvers osqp,ospq", 'option --solvers: "ospq"'),
    ("profile --horizons 401", 'option --horizons: "401"'),
    ("profile --run nowhere", "RUN nowhere: no such folder or file"),
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
def test_bad_input_is_refused_in_one_line(line, says, bench, capsys) -> None:
    before = sorted(bench.rglob("*"))
    with pytest.raises(SystemExit) as ended:
        main(line.split())
    assert ended.value.code == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert says in err
    assert err.startswith("ltv-mpc")
    assert err.count("\n") == 1
    assert err.endswith("\n")
    assert ".rs" not in err
    assert sorted(bench.rglob("*")) == before


def test_a_name_that_holds_line_breaks_still_makes_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["sim", "a\nb.toml", "--set", "x\ny=1"]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert run(["sim", "--set", "x\ny=1"]) == 2
    assert capsys.readouterr().err.count("\n") == 1
