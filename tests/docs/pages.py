"""Parser of the pages (README, CONTRIBUTING, SECURITY, docs): fenced blocks, shell commands, text between backticks."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGES = (
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "SECURITY.md")),
    *sorted((ROOT / "docs").rglob("*.md")),
)
NAMES = tuple(page.relative_to(ROOT).as_posix() for page in PAGES)

FENCE = re.compile(r"^ {0,3}(```+)([^`]*)$")


@dataclass(frozen=True)
class Block:
    """Fenced block of a page."""

    page: str
    line: int  # of the opening fence
    language: str
    text: str

    @property
    def place(self) -> str:
        """Position as FILE:LINE."""
        return f"{self.page}:{self.line}"


@dataclass(frozen=True)
class Command:
    """Command of a shell block, without leading ``NAME=value`` and comments, with continued lines joined."""

    place: str
    words: tuple[str, ...]

    @property
    def text(self) -> str:
        """Command in one line."""
        return " ".join(self.words)

    @property
    def ltv_mpc(self) -> tuple[str, ...] | None:
        """Arguments of ``ltv-mpc``; None for other programs."""
        return self.words[1:] if self.words[0] in ("ltv-mpc", ".venv/bin/ltv-mpc") else None


def blocks(page: str) -> list[Block]:
    """Return every fenced block of a page, in order."""
    found: list[Block] = []
    opened: tuple[int, str, str] | None = None
    lines: list[str] = []
    for number, line in enumerate((ROOT / page).read_text(encoding="utf-8").splitlines(), start=1):
        fence = FENCE.match(line)
        if opened is None and fence:
            opened, lines = (number, fence[1], fence[2].strip()), []
        elif opened is not None and fence and fence[1] == opened[1] and not fence[2].strip():
            found.append(Block(page, opened[0], opened[2].partition(" ")[0], "\n".join(lines) + "\n"))
            opened = None
        elif opened is not None:
            lines.append(line)
    assert opened is None, f"{page}:{opened and opened[0]}: a block without an end"
    return found


def prose(page: str) -> list[tuple[int, str]]:
    """Return the lines outside of blocks with their numbers; the lines of a block are empty."""
    lines = (ROOT / page).read_text(encoding="utf-8").splitlines()
    for block in blocks(page):
        length = block.text.count("\n") + 2
        lines[block.line - 1 : block.line - 1 + length] = [""] * length
    return list(enumerate(lines, start=1))


def commands(block: Block) -> Iterator[Command]:
    """Yield each command of a shell block."""
    number = block.line
    for line in block.text.replace("\\\n", "\0").splitlines():
        number += 1
        words = shlex.split(line.replace("\0", " "), comments=True)
        place = f"{block.page}:{number}"
        number += line.count("\0")
        for part in _split(words):
            while part and re.match(r"^[A-Z_]+=", part[0]):
                part.pop(0)
            if part:
                yield Command(place, tuple(part))


def _split(words: list[str]) -> Iterator[list[str]]:
    """Split a list of words at ``&&``."""
    part: list[str] = []
    for word in words:
        if word == "&&":
            yield part
            part = []
        else:
            part.append(word)
    yield part


def spoken(page: str) -> list[tuple[int, str]]:
    """Return the texts between single backticks outside of blocks, with their lines."""
    return [
        (number, " ".join(found.split()))
        for number, text in _paragraphs(page)
        for found in re.findall(r"(?<!`)`([^`]+)`(?!`)", text)
    ]


def _paragraphs(page: str) -> Iterator[tuple[int, str]]:
    """Yield the paragraphs with their first lines: a text between backticks may span two lines."""
    begun, lines = 0, []
    for number, line in [*prose(page), (0, "")]:
        if line.strip():
            begun = begun or number
            lines.append(line)
        elif lines:
            yield begun, "\n".join(lines)
            begun, lines = 0, []


def slug(heading: str) -> str:
    """Return the anchor of a heading on GitHub and on the site."""
    words = re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", heading).strip().lower()
    return re.sub(r"[^\w\- ]", "", words).replace(" ", "-")


def anchors(page: str) -> set[str]:
    """Return the anchors of all headings of a page, and of a page that it includes."""
    text = (ROOT / page).read_text(encoding="utf-8")
    included = [
        ((ROOT / page).parent / path).resolve().relative_to(ROOT).as_posix()
        for path in re.findall(r"^```\{include\} +(\S+)$", text, re.MULTILINE)
    ]
    own = {slug(found[1]) for _, line in prose(page) if (found := re.match(r"^#{1,6} +(.*)$", line))}
    return own.union(*map(anchors, included))


def links(page: str) -> list[tuple[int, str]]:
    """Return the targets of links and images, with their lines."""
    return [
        (number, target)
        for number, line in prose(page)
        for target in re.findall(r"\]\(([^()\s]+)\)", re.sub(r"`[^`]*`", "", line))
    ]
