"""Commands: help and its cost, precedence of options, content of stdout, imports of a process."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import threading
from pathlib import Path
from types import SimpleNamespace

import pytest
import shellingham

from services.cli.app import run
from services.processes import recorder
from services.recording.reader import Recording

pytestmark = pytest.mark.usefixtures("without_report")


def cli(line: str) -> int:
    return run(line.split())


def test_shell_completion_knows_every_command_and_is_not_in_the_way_of_help(capsys, monkeypatch) -> None:
    assert run(["doctor", "--help"]) == 0
    assert "completion" not in capsys.readouterr().out
    monkeypatch.setattr(shellingham, "detect_shell", lambda: ("bash", "/bin/bash"))  # whatever has started the tests
    with pytest.raises(SystemExit) as done:
        cli("completion")
    assert done.value.code == 0
    assert "complete -o default" in capsys.readouterr().out
    for name, value in (("_LTV_MPC_COMPLETE", "complete_bash"), ("COMP_WORDS", "ltv-mpc log "), ("COMP_CWORD", "2")):
        monkeypatch.setenv(name, value)
    with pytest.raises(SystemExit):
        run([])
    assert capsys.readouterr().out.split() == ["info", "recover", "export"]


def test_help_imports_nothing_that_is_slow() -> None:
    """Numba, OSQP and scipy alone would cost 0.6 s."""
    program = """
import sys
from services.cli.app import run
for arguments in ([], ["sim", "--help"], ["controller", "--help"]):
    assert run(arguments) == 0
slow = {"numpy", "scipy", "numba", "osqp", "qpsolvers", "zenoh", "mcap", "sim"}
assert not slow & set(sys.modules)
"""
    subprocess.run([sys.executable, "-P", "-c", program], capture_output=True, timeout=60, check=True)


def test_an_option_wins_over_set_and_set_over_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("mine.toml").write_text(
        'title = "x"\n[run]\nseed = 1\nduration_s = 0.3\ncompute_delay_s = 0.1\n[controller]\nhorizon_s = 3.0\n'
    )
    line = "sim mine.toml --lockstep --out r --seed 3 --set run.seed=2 --set run.compute_delay_s=0.2 --perfect-state"
    assert cli(line) == 0
    written = Path("r/scenario.toml").read_text()
    assert "seed = 3" in written  # option
    assert "compute_delay_s = 0.2" in written  # --set
    assert "horizon_s = 3.0" in written  # file
    assert "perfect_state = true" in written


def test_json_has_stdout_to_itself_and_force_writes_into_a_folder_beside_what_is_there(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("r").mkdir()
    Path("r/mine.txt").write_text("keep")
    assert cli("sim descent --lockstep --duration-s 0.3 --json --perfect-state --out r --force") == 0
    assert json.loads(capsys.readouterr().out) == json.loads(Path("r/summary.json").read_text())
    assert Path("r/mine.txt").read_text() == "keep"


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 1)])
def test_an_interrupted_lock_step_has_its_code_and_a_readable_recording(number, code, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    recording = tmp_path / "r" / "run.mcap"
    ended = threading.Event()

    def interrupt() -> None:
        while not ended.wait(0.05):
            if recording.exists() and recording.stat().st_size > 600_000:
                os.kill(os.getpid(), number)
                return

    thread = threading.Thread(target=interrupt)
    thread.start()
    try:
        assert cli("sim descent --lockstep --duration-s 5000 --out r") == code
    finally:
        ended.set()
        thread.join()
    assert "stopped early" in capsys.readouterr().err
    messages = Recording(recording)
    assert sum(1 for _ in messages) > 1000
    assert not messages.cut
    assert 0 < json.loads((tmp_path / "r" / "summary.json").read_text())["duration_s"] < 5000


@pytest.mark.parametrize("mode", ["", "--lockstep"])
def test_a_disk_without_room_for_the_run_is_refused_before_its_folder_is_made(mode, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=10**6))
    assert cli(f"sim descent {mode} --duration-s 99 --out below/r") == 1
    assert capsys.readouterr().err.startswith("ltv-mpc: below/r: 1 MB free, 20 MB may be needed")
    assert not Path("below").exists()


def test_the_recorder_continues_its_own_folder_and_rejects_one_that_is_not_empty(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    taken: list[Path] = []

    def main(config: recorder.Config) -> int:
        taken.append(config.folder)
        return 0

    monkeypatch.setattr(recorder, "main", main)
    assert cli("sim descent --lockstep --duration-s 0.3 --perfect-state --out r") == 0
    before = Path("r/run.mcap").read_bytes()
    assert cli("recorder r/scenario.toml --out r") == 2  # it holds a run
    assert cli("recorder descent --out .") == 2
    assert Path("r/run.mcap").read_bytes() == before
    assert taken == []
    assert cli("recorder r/scenario.toml --out r --continue") == 0
    assert Path("r/run.mcap").read_bytes() == before
    assert cli("recorder descent --out new") == 0
    assert taken == [Path("r"), Path("new")]


def test_a_package_that_is_missing_is_named_in_one_line() -> None:
    program = "import sys; sys.modules['msgspec'] = None; from services.cli.app import main; main()"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr.count("\n")) == (1, 1)
    assert "msgspec is not installed" in done.stderr
