"""Walk through both tutorials as a reader does: run every block in its order, time each step, make the pictures.

    .venv/bin/python -P -m benchmarks.tutorials [--page docs/tutorial.md] [--pictures] [--output]

The blocks run in a temporary folder. ``make sim`` is run without what it installs and compiles; a browser
has the live page open. A line that a page shows and no command above it
prints ends the walk with an error. ``--pictures`` writes docs/tutorial-*.png, ``--output`` prints what the commands
print. It needs chromium or chrome on PATH, and the ports of the tutorial.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

from PIL import Image
from playwright.sync_api import Browser, Page, sync_playwright

from tests.browser.conftest import SCREEN, executable
from tests.docs.page_reader import PageReader, printed_lines
from tests.docs.pages import ROOT, Block, Command, blocks, commands, links, prose
from tests.system.alone import Lines, started

PAGES = ("docs/tutorial.md", "docs/tutorial-vehicle.md")
READY = {
    "router": "ready at",
    "controller": "waiting for",
    "dashboard": "http://",
    "examples/python/publisher.py": "m north",
}
"""Commands that run until they are stopped, and what they print when the next terminal can be used."""

SAYS = "live page: "
AT_THE_POINT = re.compile(r"-?0\.0\d m north, -?0\.0\d m east, controller")
SETTLED_S = 5
"""Lines of the publisher, one a second, that say so."""

PATIENCE_S, POLL_MS = 300.0, 100.0

REPORTS = {
    "tutorial-distance.png": ("latest", "tracking"),
    "tutorial-horizons.png": ("horizons", "tracking"),
    "tutorial-longer.png": ("longer", "tracking"),
    "tutorial-hull.png": ("still", "track"),
    "tutorial-boat.png": ("boat", "track"),
    "tutorial-heavy.png": ("both", "tracking"),
}
"""Pictures that are saved from a report with the menu of a plot: folder below runs/, and name of the plot."""

LIVE = {"sim": ("tutorial-page.png", "", 100.0), "point": ("tutorial-point.png", "#panel-track", 0.0)}
"""Pictures of the live page: file, part of the page if not all, and the vehicle time (s) at which it is taken."""

COLOURS = 256
"""Colours of a picture: a page has few more, and the file has a third of the size."""


class Walk(PageReader):
    """Reader of one page who runs each command as a process and has a browser."""

    def __init__(self, folder: Path, browser: Browser, *, pictures: bool, output: bool) -> None:
        super().__init__(folder)
        self._browser, self._pictures, self._output = browser, pictures, output
        self._environment = os.environ | {"PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}

    def save_plot(self, name: str) -> None:
        """Save a plot of a report as the reader does, with its menu."""
        if name not in REPORTS or not self._pictures:
            return
        run, plot = REPORTS[name]
        page = self._browser.new_page(viewport={"width": SCREEN[0], "height": SCREEN[1]})
        page.goto((self._folder / "runs" / run / "report.html").resolve().as_uri())
        menu = page.locator(f"#panel-{plot} details.menu").first
        menu.locator("summary").click()
        with page.expect_download() as saved:
            menu.get_by_role("button", name="PNG").click()
        write_picture(Path(saved.value.path()).read_bytes(), name)
        page.close()

    def _print(self, line: str) -> None:
        self.printed += printed_lines(line, exact=False)
        if self._output:
            print(f"    {line.rstrip()}", flush=True)

    def run(self, command: Command, code: int = 0) -> None:
        """Run a command until it ends with this exit code."""
        if command.words[:2] == ("make", "sim"):
            self._simulate()
            return
        ended = subprocess.run(
            command.words, cwd=self._folder, env=self._environment, text=True, check=False,
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        )  # fmt: skip
        assert ended.returncode == code, f"{command.place}: {command.text}: {ended.returncode}\n{ended.stdout}"
        for line in ended.stdout.splitlines():
            self._print(line)

    def _simulate(self) -> None:
        """Run the demo with the live page in a browser."""
        command = (self._program("ltv-mpc"), "sim", "--dashboard")
        with subprocess.Popen(
            command, cwd=self._folder, text=True,
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        ) as process:  # fmt: skip
            assert process.stdout is not None
            for line in process.stdout:
                self._print(line)
                if line.startswith(SAYS):
                    page = self._open(line.removeprefix(SAYS).strip())
                    self._photograph(page, "sim")
        assert process.returncode == 0
        page.close()

    def run_side_by_side(self, block: Block) -> None:
        """Run the controller alone, each command in a terminal of its own, until the vehicle is at its point."""
        with ExitStack() as terminals:
            opened: dict[str, Lines] = {}
            for command in commands(block):
                name = command.words[1]
                if name not in READY:
                    self._repeat(command)
                    continue
                words = (self._program(command.words[0]), *command.words[1:])
                _, opened[name] = terminals.enter_context(started(*words, cwd=self._folder))
                line = opened[name].until(lambda line, ready=READY[name]: ready in line)
                if name == "dashboard":
                    page = self._open(line.strip(), scale=2)
                    page.click("#panel-track button:text-is('whole track')")
            publisher = opened["examples/python/publisher.py"]
            for _ in range(SETTLED_S):
                publisher.until(lambda line: AT_THE_POINT.match(line) is not None)
            for line in publisher.said:
                self._print(line)
            self._photograph(page, "point")
            page.close()

    def _repeat(self, command: Command) -> None:
        """Run a command until it succeeds: the controller rejects `arm` before its first estimate."""
        deadline = time.monotonic() + PATIENCE_S
        while True:
            try:
                return self.run(command)
            except AssertionError:
                assert time.monotonic() < deadline

    def _program(self, name: str) -> str:
        return str(Path(sys.executable).parent / name)

    def _open(self, url: str, scale: int = 1) -> Page:
        page = self._browser.new_page(viewport={"width": SCREEN[0], "height": SCREEN[1]}, device_scale_factor=scale)
        page.goto(url)
        return page

    def _photograph(self, page: Page, which: str) -> None:
        name, part, at_s = LIVE[which]
        deadline = time.monotonic() + PATIENCE_S
        while page.evaluate("Number(document.querySelector('#moment').max)") < at_s:
            assert time.monotonic() < deadline, page.inner_text("body")
            page.wait_for_timeout(POLL_MS)
        if self._pictures:
            write_picture(page.locator(part).screenshot() if part else page.screenshot(), name)


def write_picture(png: bytes, name: str) -> None:
    """Write a picture of a tutorial with few colours, which is small. Thin lines keep theirs."""
    picture = Image.open(BytesIO(png)).convert("RGB")
    picture = picture.quantize(COLOURS, method=Image.Quantize.MAXCOVERAGE, kmeans=3, dither=Image.Dither.NONE)
    picture.save(ROOT / "docs" / name, optimize=True)


class Step(NamedTuple):
    """Section of a page: its heading, and its blocks and pictures in their order."""

    heading: str
    parts: list[Block | str]


def steps(page: str) -> Iterator[Step]:
    """Yield the steps of a page."""
    parts: list[tuple[int, Block | str]] = [(block.line, block) for block in blocks(page)]
    parts += [(line, target) for line, target in links(page) if target.endswith(".png")]
    headings = [(number, line.lstrip("# ")) for number, line in prose(page) if line.startswith("## ")]
    ends = [number for number, _ in headings[1:]] + [sys.maxsize]
    for (begin, heading), end in zip(headings, ends, strict=True):
        found: list[Any] = [part for line, part in sorted(parts, key=lambda one: one[0]) if begin < line < end]
        if found:
            yield Step(heading, found)


def main() -> None:
    """Walk, and print the time of each step."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--page", choices=PAGES, action="append", help="walk through this page alone")
    parser.add_argument("--pictures", action="store_true", help="write docs/tutorial-*.png")
    parser.add_argument("--output", action="store_true", help="print the output of every command")
    options = parser.parse_args()
    with (
        sync_playwright() as play,
        play.chromium.launch(executable_path=executable(), args=["--no-sandbox"]) as browser,
    ):
        for page in options.page or PAGES:
            with tempfile.TemporaryDirectory(prefix="ltv-mpc-tutorial-") as temporary:
                folder = Path(temporary)
                (folder / "examples").symlink_to(ROOT / "examples")
                walk = Walk(folder, browser, pictures=options.pictures, output=options.output)
                print(f"{page}, load average {os.getloadavg()[0]:.1f}", flush=True)
                for step in steps(page):
                    began_s = time.monotonic()
                    for part in step.parts:
                        walk.save_plot(part) if isinstance(part, str) else walk.read(part)
                    print(f"{time.monotonic() - began_s:6.1f} s  {step.heading}", flush=True)


if __name__ == "__main__":
    main()
