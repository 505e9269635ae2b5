"""Command ``log``: inspect, recover or export a recording."""

from __future__ import annotations

import enum
from pathlib import Path
from typing import Annotated, TypeAlias

import typer

from services.cli.options import Force, Json, argument, group, option, show

log = group("log", "Inspect, recover or export the recording of a run.")

Run: TypeAlias = Annotated[str, argument("RUN", "Recorded run: its folder, its run.mcap, or latest.")]


class Format(enum.StrEnum):
    """File format of an export."""

    CSV = "csv"
    PARQUET = "parquet"


@log.command()
def info(run: Run = "latest", as_json: Json = False) -> int:
    """Show the contents: messages by key with rate, times and gaps; segments; events; completeness.

    Exit code 1 if the recording is incomplete.
    """
    import msgspec

    from services.recording import info as figures
    from services.recording.recover import segments
    from services.reporting.terminal import reading_progress
    from services.run import folder

    recording = folder.find(run)
    with reading_progress(recording):
        found = figures.read(segments(recording))
    if not found.why and isinstance(why := folder.read_summary(recording).get("why"), str):
        found = msgspec.structs.replace(found, why=why)
    from services.reporting import log_text

    show(found, lambda: log_text.text(found), as_json=as_json)
    return 0 if found.whole else 1


@log.command()
def recover(
    run: Run = "latest",
    out: Annotated[
        Path | None, option("FILE", "File to write. Default run.recovered.mcap beside the recording.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Write a complete file from one that was cut off, damaged or left in segments (run.mcap, run.2.mcap, ...).

    Copies every complete message unchanged; the original stays, and no file is overwritten. Nothing is written if the
    recording is complete (--json: null).
    """
    from services.recording import recover as recovery
    from services.run import folder

    recording = folder.find(run)
    parts = recovery.segments(recording)
    if len(parts) == 1 and recovery.is_whole(recording):
        typer.echo(f"{recording} is complete: nothing to recover", err=as_json)
        if as_json:
            typer.echo("null")
        return
    from services.reporting.terminal import reading_progress

    with reading_progress(recording):
        made = recovery.recover(parts, out or recovery.recovered_path(recording))
    from services.reporting import log_text

    show(made, lambda: f"{log_text.recovered(made)}\n{made.file}", as_json=as_json)


@log.command()
def export(
    run: Run = "latest",
    form: Annotated[Format, typer.Option("--format", help="Format of the tables.")] = Format.CSV,
    out: Annotated[
        Path | None, option("DIR", "Folder to write. Default: a folder with the name of the format in RUN.")
    ] = None,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Write one table for each key."""
    from services.recording import export as tables
    from services.recording.recover import segments
    from services.run import folder

    recording = folder.find(run)
    parts = segments(recording)
    if form is Format.PARQUET:
        tables.need_pyarrow()
    place = folder.open_folder(out or recording.parent / form.value, force=force)
    from services.reporting import log_text
    from services.reporting.terminal import reading_progress

    with reading_progress(f"{recording} as {form.value}, twice"):
        result = tables.export(parts, place, "csv" if form is Format.CSV else "parquet")
    show(result, lambda: f"{log_text.exported(result)}\n{place}", as_json=as_json)
