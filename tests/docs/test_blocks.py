"""Whatever README and docs/ print to be typed is run here, page by page, in the page's own order and one folder.

A page is a session: its Python shares one set of names, its files lie where its commands look for them, and what a
command writes the next one finds. Runs are taken from one short run in lock step: `sim` resolves its options, makes its
folder and is then given that recording. What is not run at all stands in ``NOT_RUN`` with the reason, and its options
are held against the command line all the same. A block that is neither fails.
"""

from __future__ import annotations

import ast
import math
import re
import shutil
import tomllib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, get_args

import pytest
from typer.core import TyperGroup
from typer.main import get_command

from ltv_mpc import Fence
from ltv_mpc.control.config import ControllerConfig
from ltv_mpc.localisation.config import EstimatorConfig
from services.cli import bus, start
from services.cli.app import app, run
from services.run.folder import RunFolder
from services.run.run_config import RunConfig
from services.runtime.stopping import DONE
from services.tools.campaign import file as campaigns
from tests.docs.pages import NAMES, ROOT, Command, blocks, commands, prose, spoken

RUN_HERE = {"sh", "python", "toml", "json"}
SHOWN = {"text", "diff", "{toctree}", "{eval-rst}", "{include}"}
"""Outputs, equations and drawings; changes of the code (test_add_pages.py builds them); the site's own directives."""

UNTIL_STOPPED = "a process that runs until it is stopped; tests/system, tests/services/launch start it"
MINUTES = "takes minutes; a short one is run by"
ELSEWHERE = "needs another host, or somebody else's program"
NOT_RUN = (
    (r"ltv-mpc (router|plant|sensors|estimator|controller|recorder|ros2|mavlink|dashboard|watch)\b", UNTIL_STOPPED),
    (r"ltv-mpc ctl\b", "needs a running controller; tests/services/cli/test_ctl.py has one"),
    (r"ltv-mpc dive plan\b", f"{MINUTES} tests/services/tools/dive_plan"),
    (r"ltv-mpc campaign\b", f"{MINUTES} tests/services/campaign"),
    (r"ltv-mpc profile\b", f"{MINUTES} tests/services/tools/profile/test_run.py"),
    (r"ltv-mpc vehicle identify\b", "needs a rich run; tests/services/cli/test_vehicle_file.py has one"),
    (r"make \w+", "the Makefile's targets: that they exist is looked at"),
    (
        r"\.venv/bin/python -m benchmarks\.",
        f"{MINUTES} whoever needs its figures: that it has these options is looked at",
    ),
    (r"python3? \S*(publisher|publish_obstacles)\.py", f"{UNTIL_STOPPED}: tests/examples"),
    (r"\.venv/bin/pytest tests/", "the tests themselves"),
    (
        r"python3 -m venv|pip (?:install|download)|\. \S+/activate|git (?:clone|worktree)|cd ",
        "makes environments; `make package` does it for real",
    ),
    (r"jupytext ", "needs the extra notebook; tests/examples runs it where it is installed"),
    (r"dask |podman |zenoh-bridge-ros2dds |scp |sudo |systemctl ", ELSEWHERE),
)

ONCE = r"ltv-mpc (replay latest$|report latest$|doctor|log info latest$|log export latest --format parquet)"
"""What needs nothing of its page and leaves nothing that the page reads: run on the first one that has it."""

ran_already: set[tuple[str, ...]] = set()

TOML: dict[str, Callable[[Path], object]] = {
    "docs/missions.md": lambda path: ControllerConfig.load(str(path)),
    "docs/currents.md": lambda path: EstimatorConfig.load(str(path)),
    "docs/motion-limits.md": lambda path: ControllerConfig.load(str(path)),
    "docs/weights.md": lambda path: ControllerConfig.load(str(path)),
    "docs/campaigns.md": campaigns.load,
}
"""Who reads the files that a page shows; what a page's own commands read needs nobody else."""


def shipped(path: str) -> str:
    return (ROOT / path).read_text(encoding="utf-8")


FILES = {
    "otter.toml": lambda: shipped("ltv_mpc/vehicle/files/surface.toml"),
    "lawn.toml": lambda: shipped("ltv_mpc/references/files/lawnmower.toml"),
    "my_sensors.toml": lambda: shipped("examples/sensors/own_adcp.toml"),
    "profile.csv": lambda: "depth_m,v_north_mps,u_east_mps\n0,0.04,0\n50,0,0.02\n",
    "other/controller.toml": lambda: "horizon_s = 9.0\n",
}
"""What readers have of their own."""

RUNS = ("first", "second")
"""Below runs/; the last one is the newest."""


# --- what every page holds to ----------------------------------------------------------------------------------------


def test_every_block_says_what_it_is_and_hides_no_command() -> None:
    for page in NAMES:
        for block in blocks(page):
            assert block.language in RUN_HERE | SHOWN, f"{block.place}: {block.language!r}"
            if block.language in SHOWN:
                hidden = re.search(r"^\s*(\.venv/bin/|ltv-mpc |make |python3? -m )", block.text, re.MULTILINE)
                assert hidden is None or block.text.startswith("ltv-mpc: "), f"{block.place}: {hidden and hidden[0]}"
        before = ""
        for number, line in prose(page):
            indented = line.startswith("    ") and not before.strip()
            assert not indented, f"{page}:{number}: a block without fences, which nobody would run"
            before = line if not line.startswith("    ") else before


def test_every_command_between_backticks_exists_with_its_options() -> None:
    targets = set(re.findall(r"^([a-z-]+):", shipped("Makefile"), re.MULTILINE))
    for page, number, words in ((name, *each) for name in NAMES for each in spoken(name)):
        text = words.removeprefix(".venv/bin/")
        if text.startswith("ltv-mpc "):
            mentioned(text.split()[1:], f"{page}:{number}")
        elif found := re.match(r"make ([a-z-]+)\b", text):
            assert found[1] in targets, f"{page}:{number}: {text}"
        elif found := re.match(r"python -m (benchmarks\.[\w.]+)(.*)", text):
            benchmark(found[1], found[2].split(), f"{page}:{number}")


# --- what is typed ---------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> RunFolder:
    """Return a recorded run that replaces every run of the pages."""
    folder = tmp_path_factory.mktemp("runs") / "recorded"
    assert run(["sim", "descent", "--lockstep", "--duration-s", "3", "--out", str(folder)]) == 0
    return RunFolder(folder)


@pytest.fixture
def session(recorded: RunFolder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a working folder with recorded runs, in which `sim` copies the recorded run instead of running."""

    def simulated(_run_config: RunConfig, folder: RunFolder, *_: object, **__: object) -> int:
        for path in recorded.path.iterdir():
            if path.is_file() and path.name != "scenario.toml":
                shutil.copy(path, folder.path)
        return DONE

    monkeypatch.setattr(start, "_run_in_lockstep", simulated)
    monkeypatch.setattr(start, "_run_processes", simulated)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    for name in RUNS:
        shutil.copytree(recorded.path, tmp_path / "runs" / name)
    (tmp_path / "runs" / "latest").symlink_to(RUNS[-1])
    (tmp_path / "runs" / "latest" / "scenario.toml").touch()
    for name, text in FILES.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text(), encoding="utf-8")
    return tmp_path


TYPED = [page for page in NAMES if any(block.language in RUN_HERE for block in blocks(page))]


@pytest.mark.parametrize("page", TYPED)
def test_what_a_page_says_to_type_works(page: str, session: Path, capsys: pytest.CaptureFixture[str]) -> None:
    names: dict[str, Any] = {}
    for block in blocks(page):
        if block.language == "python":
            code = compile("\n" * block.line + block.text, str(ROOT / page), "exec")
            exec(code, names)
        elif block.language == "toml":
            write_toml(block.text, session, page, block.place)
        elif block.language == "json":
            Fence.from_geojson(block.text, block.place)
        elif block.language == "sh":
            for command in commands(block):
                typed(command, capsys)
    if page == "README.md":  # its loop brings the vehicle to its point
        assert math.hypot(names["estimate"].north_m, names["estimate"].east_m) < 0.1
        assert names["plan"].origin == "solved"


def typed(command: Command, capsys: pytest.CaptureFixture[str]) -> None:
    """Run a command, or check that it is listed in ``NOT_RUN`` and has a valid form."""
    plain = command.text.removeprefix(".venv/bin/")
    kept = any(re.match(pattern, text) for pattern, _ in NOT_RUN for text in (plain, command.text))
    ours = command.ltv_mpc
    if ours is not None:
        parsed(list(ours), command.place)
        if not kept and ours not in ran_already:
            if re.match(ONCE, plain):
                ran_already.add(ours)
            code = run(list(ours))
            said = capsys.readouterr()
            assert code == 0, f"{command.place}: {command.text}\n{said.out[-1000:]}\n{said.err[-1000:]}"
        return
    assert kept, f"{command.place}: {command.text}: neither run nor in NOT_RUN"
    if command.words[0] == "make":
        assert re.search(rf"^{command.words[1]}:", shipped("Makefile"), re.MULTILINE), command.place
        for word in command.words[2:]:
            assert re.search(rf"^{word.partition('=')[0]} =", shipped("Makefile"), re.MULTILINE), command.place
    elif "-m" in command.words and command.words[2].startswith("benchmarks."):
        benchmark(command.words[2], list(command.words[3:]), command.place)


def write_toml(text: str, folder: Path, page: str, place: str) -> None:
    """Write a TOML block of a page to a file; its first line is a comment with the name of the file."""
    tomllib.loads(text)
    named = re.match(r"# ([\w/-]+\.toml)\b", text)
    assert named, f"{place}: the first line must be a comment with the file's name"
    path = folder / named[1]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    if page in TOML:
        TOML[page](path)


# --- the command line ------------------------------------------------------------------------------------------------


@cache
def tree() -> Any:
    """Return the tree of all commands."""
    return get_command(app)


def parsed(words: list[str], place: str) -> None:
    """Parse a command line: every option and argument exists and has the right type."""
    command = tree()
    if not words or words[0].startswith("-"):
        return
    while isinstance(command, TyperGroup):
        assert words, f"{place}: a command is missing"
        assert words[0] in command.commands, f"{place}: ltv-mpc has no {words[0]}"
        command = command.commands[words.pop(0)]
    command.make_context(place, words)


def mentioned(words: list[str], place: str) -> None:
    """Check a command in a sentence: its name and options exist; its arguments may be placeholders."""
    command = tree()
    options = {"--help", "-h", "--version"}
    while isinstance(command, TyperGroup) and words and not words[0].startswith("-"):
        if words[0].isupper() or words[0] == "...":
            return
        several = [word.strip() for word in words[0].split("|")]
        for name in several:
            assert name in command.commands, f"{place}: ltv-mpc has no {name}"
        command = command.commands[several[0]]
        words = words[1:]
    if command.name == "ctl" and words and words[0].islower():
        assert words[0] in get_args(bus.ActionName), f"{place}: ctl has no action {words[0]}"
    options |= {name for parameter in command.params for name in (*parameter.opts, *parameter.secondary_opts)}
    for word in words:
        option = word.strip("[]").partition("=")[0]
        assert not re.match(r"--?[a-z]", option) or option in options, f"{place}: {word}"


def benchmark(module: str, words: list[str], place: str) -> None:
    """Check that a benchmark module exists and knows the options."""
    folder = ROOT.joinpath(*module.split("."))
    source = next((path for path in (folder.with_suffix(".py"), folder / "__main__.py") if path.is_file()), None)
    assert source is not None, f"{place}: no {module}"
    nodes = list(ast.walk(ast.parse(source.read_text(encoding="utf-8"))))
    for node in list(nodes):  # options that several benchmarks share stand in a module of theirs
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("benchmarks."):
            shared = ROOT.joinpath(*str(node.module).split(".")).with_suffix(".py")
            nodes += ast.walk(ast.parse(shared.read_text(encoding="utf-8"))) if shared.is_file() else ()
    known = {node.value for node in nodes if isinstance(node, ast.Constant)}
    for word in words:
        if word.startswith("--"):
            assert word.partition("=")[0] in known, f"{place}: {module} has no {word}"


# --- the files that the pages name -----------------------------------------------------------------------------------

FOLDERS = "benchmarks|docs|examples|ltv_mpc|services|sim|tests"
NAMED = re.compile(rf"`(?:\.venv/bin/)?(?:python -m )?((?:(?:benchmarks|tests)\.|(?:{FOLDERS})/)[\w./-]+)")
OLD_VERSION = re.compile(r"[^`]*`,? of version [0-9a-f]{8}\b")
"""Place of a file that is not in this version, after its name."""


def absent(text: str) -> list[str]:
    """Return the files and modules that a text names and that neither this version has nor a version is named for."""
    found = []
    for named in NAMED.finditer(text):
        name = named[1].rstrip("./")
        path = ROOT / (name if "/" in name else name.replace(".", "/"))
        candidates = (path, path.with_name(f"{path.name}.py"), path.parent.with_name(f"{path.parent.name}.py"))
        if not any(each.exists() for each in candidates) and not OLD_VERSION.match(text, named.end()):
            found.append(name)
    return found


def test_every_file_that_a_page_names_exists_or_has_its_version() -> None:
    named = {page: absent("\n".join(line for _, line in prose(page))) for page in NAMES}
    assert {page: names for page, names in named.items() if names} == {}
