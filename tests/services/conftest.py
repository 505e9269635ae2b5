"""What tests of processes and sessions share."""

from __future__ import annotations

import pytest

from services.supervisor import loopback


@pytest.fixture(scope="module")
def free_port() -> int:
    """Return a free TCP port of loopback."""
    return loopback.free_port()
