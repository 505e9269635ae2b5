"""Publish counts: messages that each process has published, by its last status, compared with the recorded ones.

Memory is bounded: if there are too many processes, the account of the one that has been silent longest is closed.
"""

from __future__ import annotations

MAX_EPOCHS = 1_000
"""Process starts that are counted separately. A run has eight, and one more for each restart."""

MAX_LOST = 1_000_000
"""Largest number of messages that one process may have lost; a status that gives a larger one is false."""


class _Account:
    __slots__ = ("count", "node", "published")

    def __init__(self, count: int | None) -> None:
        self.count = count  # recorded messages; None: it published before counting began
        self.published: int | None = None
        self.node = ""

    @property
    def gap(self) -> int:
        return 0 if self.count is None or self.published is None else self.published - self.count


class PublishCounts:
    """Counts of recorded messages by the epoch of their process. The last status counts as a message too."""

    def __init__(self, *, max_epochs: int = MAX_EPOCHS) -> None:
        self._max_epochs = max_epochs
        self._accounts: dict[int, _Account] = {}  # in the order of their newest message
        self._closed: dict[str, int] = {}  # missing messages of the closed accounts, by node

    def count(self, epoch: int, *, late: bool = False) -> bool:
        """Count a message. Return True if the process is counted from its first message on.

        A new process with ``late`` is not: it has published before, so its count cannot show a loss.
        """
        account = self._accounts.pop(epoch, None) or _Account(None if late else 0)
        self._accounts[epoch] = account
        if account.count is not None:
            account.count += 1
        if len(self._accounts) > self._max_epochs:
            self._close_oldest()
        return account.count is not None

    def discount(self, epoch: int) -> None:
        """Remove one counted message: it is not in the file after all, or it is a duplicate."""
        account = self._accounts.get(epoch)
        if account is not None and account.count is not None:
            account.count -= 1

    def set_published(self, epoch: int, node: str, published: int) -> None:
        """Set the number of messages that a process has published, by its last status, which is included."""
        account = self._accounts.get(epoch)
        if account is not None and published - (account.count or 0) <= MAX_LOST:
            account.node, account.published = node, published

    def unfinished(self, own: int) -> bool:
        """Return True if the last status of any process other than ``own`` is still to come."""
        return any(account.published is None for epoch, account in self._accounts.items() if epoch != own)

    @property
    def missing(self) -> dict[str, int]:
        """Published minus recorded messages, by process, where the difference is not 0."""
        gaps = dict(self._closed)
        for account in self._accounts.values():
            gaps[account.node] = gaps.get(account.node, 0) + account.gap
        return {node: gap for node, gap in gaps.items() if gap}

    def _close_oldest(self) -> None:
        account = self._accounts.pop(next(iter(self._accounts)))
        if account.gap and (account.node in self._closed or len(self._closed) < self._max_epochs):
            self._closed[account.node] = self._closed.get(account.node, 0) + account.gap
