"""Command ``doctor``: check this machine."""

from __future__ import annotations

import typer

from services.cli.options import Json
from services.runtime.console import fold

INDENT = 25
"""Columns before what was found: severity and check."""


def doctor(as_json: Json = False) -> int:
    """Check this machine and print a remedy for each problem.

    Exit code 1 if there is a problem; a warning is not a problem.
    """
    import json  # not msgspec, which may be the package that is missing
    from dataclasses import asdict

    from services.tools.doctor import Level, examine

    found = examine()
    if as_json:
        counts = {level.value: sum(finding.level is level for finding in found) for level in Level}
        typer.echo(json.dumps({"findings": [asdict(finding) for finding in found], "counts": counts}))
    else:
        for finding in found:
            typer.echo(fold(f"{finding.level:<8} {finding.check:<15} {finding.found}", indent=INDENT))
            if finding.remedy:
                typer.echo(fold(f"{'':<{INDENT}}-> {finding.remedy}", indent=INDENT + 3))
        typer.echo("\n`ltv-mpc completion --install` adds completion of commands and options.")
    return int(any(finding.level is Level.PROBLEM for finding in found))
