"""Resources that a run needs are checked before anything is made."""

from __future__ import annotations

import resource

import pytest

from services.run.host_resources import MIN_OPEN_FILES, check_open_files


def test_a_hard_limit_of_24_open_files_is_named_with_what_raises_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(resource, "getrlimit", lambda _: (24, 24))
    with pytest.raises(OSError, match=r"limit on open files is 24 \(`ulimit -n`\), a run needs 64: raise it with"):
        check_open_files()


def test_a_soft_limit_is_raised() -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (MIN_OPEN_FILES - 1, hard))
    try:
        check_open_files()
        assert resource.getrlimit(resource.RLIMIT_NOFILE) == (MIN_OPEN_FILES, hard)
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
