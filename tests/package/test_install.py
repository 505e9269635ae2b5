"""Pip installs from the same package sources as uv."""

from __future__ import annotations

import importlib.util
import sys
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


@pytest.mark.parametrize(("keeps_bytecode", "uv", "pip"), [(False, True, "--compile"), (True, False, "--no-compile")])
def test_bytecode_is_made_where_python_will_not_keep_it(
    install: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str], keeps_bytecode: bool, uv: bool, pip: str
) -> None:
    commands: list[list[str]] = []

    def run(command: list[str], **_: object) -> int:
        commands.append(command)
        return int("-e" in command)  # nothing gets installed

    install.LOG = tmp_path / "install.log"
    install.LOG.write_text("no space left\n")
    assert install.main(["dev"], keeps_bytecode=keeps_bytecode, run=run) == 1
    by_uv, by_pip = (command for command in commands if "-e" in command)
    assert ("--compile-bytecode" in by_uv) is uv
    assert pip in by_pip
    assert "no space left" in capsys.readouterr().err


def test_the_output_is_in_the_log(install: ModuleType, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    install.LOG = tmp_path / "install.log"
    command = [sys.executable, "-c", "import sys; print('details'); print('more', file=sys.stderr); sys.exit(3)"]
    assert install.logged(command) == 3
    assert sorted(install.LOG.read_text().split()) == ["details", "more"]
    assert capfd.readouterr() == ("", "")
