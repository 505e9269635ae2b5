"""Pip installs from the same package sources as uv."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture
def install() -> ModuleType:
    spec = importlib.util.spec_from_file_location("install", ROOT / ".ci" / "install.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_without_settings_the_strategy_is_pips(install: ModuleType) -> None:
    assert install.sources("") == {"UV_INDEX_STRATEGY": "unsafe-best-match"}


def test_indexes_folders_and_certificates_are_handed_on(install: ModuleType) -> None:
    settings = (
        "global.cert='/a/cert.pem'\n"
        "global.extra-index-url='https://one/simple https://two/simple'\n"
        "global.find-links='/a/wheels /b/wheels'\n"
        "global.timeout='60'\n"
        "download.index-url='https://not-this/simple'\n"
    )

    assert install.sources(settings) == {
        "UV_INDEX_STRATEGY": "unsafe-best-match",
        "SSL_CERT_FILE": "/a/cert.pem",
        "UV_INDEX": "https://one/simple https://two/simple",
        "UV_FIND_LINKS": "/a/wheels,/b/wheels",
    }


def test_the_environment_overrides_the_file_and_install_overrides_global(install: ModuleType) -> None:
    of_file = "global.index-url='https://all/simple'\ninstall.index-url='https://install/simple'\n"

    assert install.sources(of_file)["UV_DEFAULT_INDEX"] == "https://install/simple"
    assert (
        install.sources(":env:.index-url='https://env/simple'\n" + of_file)["UV_DEFAULT_INDEX"] == "https://env/simple"
    )
