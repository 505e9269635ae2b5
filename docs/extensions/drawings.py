"""Drawings of docs/architecture.md, made from the code.

Processes and topics come from ``services/bus/topics.py`` and ``services/supervisor/process_table.py``, layers from the
import contracts in pyproject.toml, the cycle from the controller's settings, and the estimator's parts from the
registry of the sensors and from docstrings. ``make protocol`` writes them; a test fails if a file differs.
"""

from __future__ import annotations

import ast
import re
import textwrap
import tomllib
from pathlib import Path
from xml.sax.saxutils import escape

from ltv_mpc import ControllerConfig, Vehicle
from ltv_mpc.control.config import STAGE_NS
from ltv_mpc.control.resolution import settled
from ltv_mpc.localisation.sensors import PUBLISHED, SENSORS
from ltv_mpc.messages import Estimate
from services.bus.topics import BY_TYPE, TOPICS, Topic
from services.supervisor.process_table import PROCESSES

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "docs" / "figures"
WIDTH = 900
INK, GREY, FILL, DARK_FILL = "#1a1a1a", "#707070", "#e8eef4", "#c5d5e4"
CHARACTER = 0.52
"""Mean width of a character over the size of its font."""


class Drawing:
    """SVG elements on a white ground, which is readable on a dark page too."""

    def __init__(self) -> None:
        self._parts: list[str] = []

    def text(self, x: float, y: float, text: str, *, size: int = 13, anchor: str = "start", fill: str = INK) -> None:
        """Add one line of text; (x, y) is on its base line."""
        self._parts.append(
            f'<text x="{x:g}" y="{y:g}" font-size="{size}" text-anchor="{anchor}" fill="{fill}">{escape(text)}</text>'
        )

    def box(self, x: float, y: float, width: float, height: float, fill: str = FILL) -> None:
        """Add a rectangle."""
        self._parts.append(
            f'<rect x="{x:g}" y="{y:g}" width="{width:g}" height="{height:g}" rx="4" fill="{fill}" stroke="{GREY}"/>'
        )

    def line(self, x: float, y: float, to_x: float, to_y: float, *, arrow: bool = False, stroke: str = INK) -> None:
        """Add a line, with an arrow head at its end or without."""
        head = ' marker-end="url(#head)"' if arrow else ""
        self._parts.append(
            f'<line x1="{x:g}" y1="{y:g}" x2="{to_x:g}" y2="{to_y:g}" stroke="{stroke}" stroke-width="1.3"{head}/>'
        )

    def dot(self, x: float, y: float, radius: float = 3.5, fill: str = INK) -> None:
        """Add a filled circle."""
        self._parts.append(f'<circle cx="{x:g}" cy="{y:g}" r="{radius:g}" fill="{fill}"/>')

    def titled_box(self, x: float, y: float, width: float, title: str, text: str, min_height: float = 0.0) -> float:
        """Add a box with a title and wrapped text, and return its height."""
        lines = textwrap.wrap(text, int((width - 20) / (12 * CHARACTER)))
        height = max(28.0 + 16 * len(lines), min_height)
        self.box(x, y, width, height)
        self.text(x + 10, y + 19, title, size=14)
        for i, line in enumerate(lines):
            self.text(x + 10, y + 36 + 16 * i, line, size=12, fill=GREY)
        return height

    def svg(self, height: float, title: str) -> str:
        """Return the file's text."""
        head = (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height:g}" font-family="sans-serif" '
            f'role="img"><title>{escape(title)}</title>'
            '<defs><marker id="head" viewBox="0 0 8 8" refX="8" refY="4" markerWidth="8" markerHeight="8" '
            f'orient="auto"><path d="M0 0L8 4L0 8z" fill="{INK}"/></marker></defs>'
            f'<rect width="{WIDTH}" height="{height:g}" rx="6" fill="#fff"/>'
        )
        return "\n".join([head, *self._parts, "</svg>"]) + "\n"


def processes() -> str:
    """Draw each topic as a line from its writer to its readers."""
    mute = ("router", "recorder")  # the one carries every message, the other reads every message
    names = [row.name for row in PROCESSES if row.name not in mute]
    ends = (name for topic in TOPICS for name in (topic.written_by, *topic.read_by))
    names = list(dict.fromkeys([*names, *(name for name in ends if name != "*")]))
    drawing, top, step = Drawing(), 52, 19
    column = {name: 285 + i * (WIDTH - 330) / (len(names) - 1) for i, name in enumerate(names)}
    bottom = top + step * len(TOPICS)
    for name, x in column.items():
        ours = any(row.name == name for row in PROCESSES)
        drawing.box(x - 34, 14, 68, 24, DARK_FILL if ours else FILL)
        drawing.text(x, 31, name, size=12, anchor="middle")
        drawing.line(x, 38, x, bottom, stroke="#d5d5d5")
    for i, topic in enumerate(TOPICS):
        _draw_topic(drawing, topic, column, top + step * (i + 0.5))
    return drawing.svg(bottom + 16, "Topics, from the process that writes each to those that read it")


def _draw_topic(drawing: Drawing, topic: Topic, column: dict[str, float], y: float) -> None:
    everyone = [row.name for row in PROCESSES if row.name in column]
    writers = everyone if topic.written_by == "*" else [topic.written_by]
    readers = [name for name in everyone if name not in writers] if "*" in topic.read_by else topic.read_by
    drawing.text(14, y + 4, f"{topic.key}/*" if topic.written_by == "*" else topic.key, size=12)
    period = f"{topic.period_ns / 1e9:.3g} s" if topic.period_ns else "events"
    drawing.text(232, y + 4, period, size=12, anchor="end", fill=GREY)
    for name in readers:
        x = column[name]
        if name in writers:  # a process that reads its own messages: after a restart, or for its statistics
            drawing.dot(x, y, 7, DARK_FILL)
            continue
        start = min((column[writer] for writer in writers), key=lambda at, x=x: abs(at - x))
        drawing.line(start, y, x, y, arrow=True)
    drawing.line(column[writers[0]], y, column[writers[-1]], y, stroke=GREY)
    for name in writers:
        drawing.dot(column[name], y)


def layers() -> str:
    """Draw packages and folders by the import contracts: each imports only those below it."""
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"][
        "contracts"
    ]
    packages, folders = (contract["layers"] for contract in contracts if contract["type"] == "layers")
    drawing, y = Drawing(), 14.0
    for package in packages:
        inner = folders if package == "services" else []
        start = y
        y += 30
        for layer in inner:
            names = [name.strip() for name in layer.split("|")]
            width = (WIDTH - 48 - 8 * (len(names) - 1)) / len(names)
            texts = [_first_sentence(ROOT / package / name / "__init__.py") for name in names]
            height = 0.0
            for i in sorted(range(len(names)), key=lambda i, texts=texts: -len(texts[i])):  # the highest box first
                title = f"{package}/{names[i]}"
                height = drawing.titled_box(24 + i * (width + 8), y, width, title, texts[i], height)
            y += height + 8
        if not inner:
            parts = sorted(path.parent.name for path in (ROOT / package).glob("*/__init__.py"))
            drawing.titled_box(24, y, WIDTH - 48, ", ".join(parts), _first_sentence(ROOT / package / "__init__.py"))
            y += 52
        drawing.text(24, start + 20, package, size=16)
        drawing.line(14, start, WIDTH - 14, start, stroke=GREY)
    return drawing.svg(y + 8, "Layers: each imports only those below it")


def cycle() -> str:
    """Draw two cycles of the controller in time, with the shipped vehicle's default settings."""
    settings = settled(ControllerConfig(), Vehicle.load("paper"))
    period_s, stage_s, delay_s = settings.period_s, STAGE_NS * 1e-9, 1.5 * BY_TYPE[Estimate].period_ns * 1e-9
    knots = [knot * stage_s for knot in settings.knots]
    scale, origin = 640 / 1.2, 190.0
    drawing, rows = Drawing(), {"estimates": 62, "cycle": 122, "plan k": 182, "plan k + 1": 242}
    about = "t0: the estimate's instant; t1: the cycle begins; t2: the plan takes effect"
    drawing.text(20, 24, about, size=12, fill=GREY)
    for name, y in rows.items():
        drawing.text(20, y + 5, name)
        drawing.line(origin - 40, y, WIDTH - 20, y, stroke="#d5d5d5")
    estimate_s = BY_TYPE[Estimate].period_ns * 1e-9
    for k in range(13):
        drawing.dot(origin + (k * estimate_s) * scale, rows["estimates"])
    for k, name in enumerate(("plan k", "plan k + 1")):
        t0 = k * period_s
        t1, t2 = t0 + 0.2 * estimate_s, t0 + 0.2 * estimate_s + delay_s
        x0, x1, x2 = (origin + t * scale for t in (t0, t1, t2))
        drawing.line(x0, rows["estimates"] + 6, x1, rows["cycle"] - 12, arrow=True)
        drawing.box(x1, rows["cycle"] - 11, 0.6 * (x2 - x1), 22, DARK_FILL)
        drawing.line(x1 + 0.6 * (x2 - x1), rows["cycle"] + 11, x2, rows[name] - 6, arrow=True)
        drawing.line(x2, rows[name], WIDTH - 20, rows[name], arrow=True)
        for knot in knots:
            if (x := x2 + knot * scale) < WIDTH - 30:
                drawing.dot(x, rows[name])
        if k == 0:
            for x, text, y in ((x0, "t0", rows["estimates"]), (x1, "t1", rows["cycle"]), (x2, "t2", rows[name])):
                drawing.text(x - 12, y - 8, text, anchor="end", fill=GREY)
    for x_s, text in ((0.0, "0"), (period_s, f"{period_s:g} s: one period")):
        drawing.line(origin + x_s * scale, 268, origin + x_s * scale, 278)
        drawing.text(origin + x_s * scale, 294, text, size=12, anchor="middle", fill=GREY)
    drawing.text(
        WIDTH - 20,
        294,
        f"plan: knots {stage_s:g} s apart at first, {settings.stages} stages to {settings.reach_s:.1f} s",
        size=12,
        anchor="end",
        fill=GREY,
    )
    return drawing.svg(310, "Two cycles of the controller in time")


def estimator() -> str:
    """Draw the parts of the estimator on the way of a measurement."""
    folder = ROOT / "ltv_mpc" / "localisation"
    listed = re.findall(r"\(``(\w+\.py)``\)", ast.get_docstring(ast.parse((folder / "estimator.py").read_text())) or "")
    files = [name for name in dict.fromkeys(listed) if name not in ("warm_restart.py", "alignment.py")]
    parts = [(name.removesuffix(".py"), _first_sentence(folder / name)) for name in files]
    inner = [(name, _first_sentence(folder / name / "__init__.py")) for name in ("filter", "adaptive")]
    drawing, y, sequencing = Drawing(), 20.0, 0.0
    for i, sensor in enumerate(SENSORS):
        drawing.box(20, 20 + 30 * i, 170, 24)
        drawing.text(105, 36 + 30 * i, BY_TYPE[PUBLISHED[sensor.name]].key, size=12, anchor="middle")
        drawing.line(190, 32 + 30 * i, 206, 32 + 30 * i)
    last = 32 + 30 * (len(SENSORS) - 1)
    drawing.line(206, 32, 206, last)
    drawing.line(206, 40, 240, 40, arrow=True)
    for i, (name, text) in enumerate(parts):
        sequencing = y if name == "sequencing" else sequencing
        height = drawing.titled_box(240, y, 320, name, text)
        if i + 1 < len(parts):
            drawing.line(400, y + height, 400, y + height + 18, arrow=True)
        y += height + 18
    drawing.line(560, y - 40, 620, y - 40, arrow=True)
    drawing.text(630, y - 36, BY_TYPE[Estimate].key)
    at, inner_y = 20.0, []
    for name, text in inner:
        inner_y.append(at)
        height = drawing.titled_box(600, at, 280, f"{name}/", text)
        at += height + 10
    drawing.line(580, inner_y[0] + 20, 580, inner_y[-1] + 20)
    drawing.line(580, sequencing + 12, 560, sequencing + 12)
    for y_part in inner_y:
        drawing.line(580, y_part + 20, 600, y_part + 20, arrow=True)
    return drawing.svg(max(y, last + 30, at), "Parts of the estimator")


def _first_sentence(path: Path) -> str:
    """Return the first sentence of a module's docstring, without markup."""
    text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    return re.split(r"(?<=\.)\s", " ".join(text.split()))[0].replace("``", "").rstrip(".")


DRAWINGS = {"processes": processes, "layers": layers, "cycle": cycle, "estimator": estimator}


def main() -> None:
    """Write every drawing."""
    for name, draw in DRAWINGS.items():
        (FOLDER / f"{name}.svg").write_text(draw(), encoding="utf-8")


if __name__ == "__main__":
    main()
