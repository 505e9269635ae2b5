"""Command ``report``: write the plots and figures of one run, or compare several runs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ltv_mpc.errors import ConfigError
from services.cli.options import Force, Json

if TYPE_CHECKING:
    from collections.abc import Sequence

    from services.reporting.report import Run


def report(
    runs: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="RUN",
            help="Folder of a run, its run.mcap, latest, or the folder of a campaign.",
            show_default="latest",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            metavar="FILE|DIR",
            help="File or folder to write. Default: in the folder of the run; for several runs runs/TIME-report.",
        ),
    ] = None,
    as_json: Json = False,
    force: Force = False,
) -> int:
    """Write a report of one run, or compare several runs.

    report.html is one file and needs no network. Recordings that were cut off are accepted.
    """
    from services.reporting import report as page
    from services.reporting.static_files import NoPlotly
    from services.reporting.terminal import reading_progress
    from services.run import folder

    if runs is not None and len(runs) == 1 and (Path(runs[0]) / "campaign.toml").is_file():
        return _of_campaign(Path(runs[0]))
    recordings = [folder.find(text) for text in runs or [folder.LATEST]]
    if len(recordings) > page.MAX_RUNS:
        raise ConfigError("argument RUN", "", f"at most {page.MAX_RUNS} runs fit into one report")
    shown = [_run(recording, name) for recording, name in zip(recordings, _names(recordings), strict=True)]
    target = _target(recordings, out, force=force)
    try:
        with reading_progress(", ".join(run.name for run in shown)):
            figures = page.write(shown, target)
    except NoPlotly as missing:
        typer.echo(f"report: {missing}: run `make setup`, or pip install plotly (extra viz)", err=True)
        return 1
    if as_json:
        import msgspec

        typer.echo(msgspec.json.encode({"report": str(target), "figures": figures}).decode())
    else:
        from services.reporting import differences

        if figures:
            typer.echo(differences.text([run.name for run in shown], figures))
        typer.echo(str(target))
    return 0


def _of_campaign(folder: Path) -> int:
    """Write the report of a campaign again, from its rows."""
    from services.reporting.static_files import NoPlotly
    from services.tools.campaign import page

    try:
        typer.echo(str(page.write(folder)))
    except NoPlotly as missing:
        typer.echo(f"report: {missing}: run `make setup`, or pip install plotly (extra viz)", err=True)
        return 1
    return 0


def after_run(recording: Path, summary: dict[str, Any]) -> str:
    """Write report.html into the folder of a run at its end; return the line to print: its path or the failure.

    A failure here does not change the exit code of the run.
    """
    from services.reporting import report as page
    from services.reporting.static_files import NoPlotly
    from services.reporting.terminal import reading_progress
    from services.run import folder

    target = recording.with_name(folder.REPORT)
    try:
        with reading_progress(folder.REPORT):
            page.write([page.Run(name=recording.parent.name, recording=recording, summary=summary)], target)
    except NoPlotly as missing:
        return f"no {folder.REPORT}: {missing}: pip install plotly (extra viz)"
    except (ConfigError, OSError) as error:
        return f"no {folder.REPORT}: {error}"
    return f"report: {target}"


def _run(recording: Path, name: str) -> Run:
    from services.reporting.report import Run
    from services.tools.python_run import summary_of

    return Run(name=name, recording=recording, summary=summary_of(recording))


def _names(recordings: Sequence[Path]) -> list[str]:
    """Return the names of the runs' folders, or their full paths if two names are equal."""
    names = [path.absolute().parent.name if path.name == "run.mcap" else path.stem for path in recordings]
    return names if len(set(names)) == len(names) else [str(path) for path in recordings]


def _target(recordings: Sequence[Path], out: Path | None, *, force: bool) -> Path:
    from datetime import UTC, datetime

    from services.run import folder

    if out is None and len(recordings) == 1:
        return recordings[0].with_name(folder.REPORT)
    if out is None:  # not by folder.make, which creates the folder of a run and links `latest` to it
        out = folder.ROOT / f"{datetime.now(UTC):%Y%m%dT%H%M%SZ}-report"
    target = out if out.suffix == ".html" else out / folder.REPORT
    if target.exists() and not force:
        raise ConfigError("option --out", "", "exists: name another, or add --force", value=str(target))
    target.parent.mkdir(parents=True, exist_ok=True)
    return target
