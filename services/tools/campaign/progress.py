"""Progress display of a campaign: runs done and left, remaining time, and the best points so far."""

from __future__ import annotations

import time
from collections.abc import Sequence
from types import TracebackType

from rich.console import Console, Group
from rich.live import Live
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, TaskID, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.progress import Progress as Bar

from ltv_mpc.errors import one_line
from services.runtime.console import counted
from services.tools.campaign import text
from services.tools.campaign.file import Campaign
from services.tools.campaign.ranking import ranked, scores
from services.tools.campaign.trial import Row

BEST = 5
TABLE_S, PLAIN_S = 2.0, 10.0
"""Time between two tables, and between two lines if there is no terminal for a progress bar."""


class Progress:
    """Progress display on stderr. ``rows`` holds all rows of the campaign, also those of earlier sessions."""

    def __init__(self, campaign: Campaign, rows: Sequence[Row], runs: int, *, quiet: bool) -> None:
        self.rows = list(rows)
        self._campaign, self._runs = campaign, runs
        self._console = Console(stderr=True, quiet=quiet and not Console(stderr=True).is_terminal)
        self._bar = Bar(
            TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(),
            TextColumn("left"), TimeRemainingColumn(elapsed_when_finished=False), console=self._console,
        )  # fmt: skip
        self._task: TaskID = self._bar.add_task(escape(one_line(campaign.title)), total=runs, completed=len(rows))
        self._live = Live(self._bar, console=self._console, auto_refresh=True, refresh_per_second=2, transient=True)
        self._began_s = self._said_s = time.monotonic()
        self._first = len(rows)

    def add(self, row: Row) -> None:
        """Add a row and update the display."""
        self.rows.append(row)
        self._bar.update(self._task, completed=len(self.rows))
        now_s = time.monotonic()
        if now_s - self._said_s < (TABLE_S if self._console.is_terminal else PLAIN_S):
            return
        self._said_s = now_s
        if self._console.is_terminal:
            best = ranked(scores(self.rows, self._campaign.minimise, self._campaign.varied), BEST)
            self._live.update(Group(text.standings(best, self._campaign.minimise), self._bar))
        else:
            each_s = (self._said_s - self._began_s) / (len(self.rows) - self._first)
            done = f"{len(self.rows)} of {counted(self._runs, 'run')}"
            left_s = each_s * (self._runs - len(self.rows))
            self._console.print(f"{done}, about {left_s:.0f} s left", highlight=False)

    def __enter__(self) -> Progress:
        if self._console.is_terminal:
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, where: TracebackType | None
    ) -> None:
        if self._console.is_terminal:
            self._live.stop()
