"""What tests of processes and sessions share."""

from __future__ import annotations

import pytest

from services.supervisor import loopback


@pytest.fixture(scope="module")
def free_port() -> int:
    """A TCP port of loopback that nobody listens on."""
    return loopback.free_port()
