"""Command ``localise``: localise a recorded ADCP dive."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Annotated

import typer

from services.cli.options import Force, Json, argument, option, show


def localise(
    file: Annotated[Path, argument("FILE.PD0", "PD0 file of a Teledyne RDI instrument.")],
    surface_fixes: Annotated[
        int, option("N", "Number of first ensembles whose bottom track is used.", min=0, max=100000)
    ] = 10,
    start_depth_m: Annotated[
        float | None, option("D", "Start at the first ensemble at or below this depth.", min=0, max=12000)
    ] = None,
    head: Annotated[str | None, option("up|down", "Head to use, of two. Default: that with more ensembles.")] = None,
    as_json: Json = False,
    force: Force = False,
    out: Annotated[Path | None, option("DIR", "Also write track, current profile, result and plot here.")] = None,
) -> int:
    """Localise a recorded ADCP dive that has no inertial unit.

    Bottom track replaces the fix at the surface during the first ensembles; later it is the reference with which the
    track is compared.
    """
    from ltv_mpc.errors import ConfigError
    from services.reporting.terminal import progress_bar
    from services.run import folder
    from services.tools.localise import dive_localisation as dive
    from services.tools.localise import text

    written = None if out is None else folder.open_folder(out, force=force)
    try:
        with progress_bar(file.name) as progress:
            outcome = dive.localise(file, surface_fixes, start_depth_m, head, progress=progress)
    except ConfigError:
        if written is not None:
            with contextlib.suppress(OSError):  # it is not empty
                written.rmdir()
        raise
    show(outcome.result, lambda: text.text(outcome.result), as_json=as_json)
    if written is not None:
        if note := dive.write(outcome, written):
            typer.echo(note, err=True)
        typer.echo(str(written), err=as_json)
    return 0
