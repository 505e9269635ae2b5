"""What each process says, in its last word, that it has published, held against what is here.

Memory is bounded: of a process that was silent longest the account is closed.
"""

from __future__ import annotations

MAX_EPOCHS = 1_000
"""Starts of processes that are counted apart. A run has eight, and one more for each restart."""


class _Account:
    __slots__ = ("count", "node", "published")

    def __init__(self, count: int | None) -> None:
        self.count = count  # None: it spoke before anybody counted
        self.published: int | None = None
        self.node = ""

    @property
    def gap(self) -> int:
        return 0 if self.count is None or self.published is None else self.published - self.count


class PublishCounts:
    """Messages by the epoch of who sent them. A last word comes through ``set_published``, and as a message too."""

    def __init__(self) -> None:
        self._accounts: dict[int, _Account] = {}  # who was heard last is the last
        self._closed: dict[str, int] = {}  # by node, what was missing of those that are forgotten

    def count(self, epoch: int, *, late: bool = False) -> bool:
        """A message; whether its source is heard from its first one on. Of a new one that is ``late`` it is not, and
        nothing can be missed.
        """
        account = self._accounts.pop(epoch, None) or _Account(None if late else 0)
        self._accounts[epoch] = account
        if account.count is not None:
            account.count += 1
        if len(self._accounts) > MAX_EPOCHS:
            self._close_oldest()
        return account.count is not None

    def discount(self, epoch: int) -> None:
        """One that was counted is not there, or was there before."""
        account = self._accounts.get(epoch)
        if account is not None and account.count is not None:
            account.count -= 1

    def set_published(self, epoch: int, node: str, published: int) -> None:
        """Its last word: it has published so many, this one included."""
        account = self._accounts.get(epoch)
        if account is not None:
            account.node, account.published = node, published

    def unfinished(self, own: int) -> bool:
        """Whether the last word of anyone but ``own`` is to come."""
        return any(account.published is None for epoch, account in self._accounts.items() if epoch != own)

    @property
    def missing(self) -> dict[str, int]:
        """By process: what it says it has published, minus what is here; only where that is not 0."""
        gaps = dict(self._closed)
        for account in self._accounts.values():
            gaps[account.node] = gaps.get(account.node, 0) + account.gap
        return {node: gap for node, gap in gaps.items() if gap}

    def _close_oldest(self) -> None:
        account = self._accounts.pop(next(iter(self._accounts)))
        if account.gap and (account.node in self._closed or len(self._closed) < MAX_EPOCHS):
            self._closed[account.node] = self._closed.get(account.node, 0) + account.gap
