"""Panel "A run": ``report``, ``replay`` and ``log info``, ``recover`` and ``export``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

import typer

from services.cli.options import Force, Json, argument, flag, group, invalid, option, plots_or_a_line, show


def report(
    runs: Annotated[
        list[str] | None,
        argument("RUN", "Folder of a run, its run.mcap, latest, or the folder of a campaign.", show_default="latest"),
    ] = None,
    out: Annotated[
        Path | None,
        option("FILE|DIR", "File or folder. Default: in the folder of the run; for several runs runs/TIME-report."),
    ] = None,
    as_json: Json = False,
    force: Force = False,
) -> None:
    """Write a report of one run, or compare several runs.

    report.html is one file and needs no network. Recordings that were cut off are accepted.
    """
    from services.reporting import differences
    from services.reporting import report as page
    from services.reporting.terminal import reading_progress
    from services.run import folder
    from services.runtime.console import columns
    from services.tools.python_run import summary_of

    if runs is not None and len(runs) == 1 and (Path(runs[0]) / "campaign.toml").is_file():
        from services.tools.campaign import page as campaign_page

        with plots_or_a_line("report", wanted=True):
            typer.echo(str(campaign_page.write(Path(runs[0]))))
        return
    recordings = [folder.find(text) for text in runs or [folder.LATEST]]
    if len(recordings) > page.MAX_RUNS:
        raise invalid("argument RUN", f"at most {page.MAX_RUNS} runs fit into one report")
    shown = [
        page.Run(name=name, recording=recording, summary=summary_of(recording))
        for recording, name in zip(recordings, _names(recordings), strict=True)
    ]
    target = _target(recordings, out, force=force)
    with plots_or_a_line("report", wanted=True), reading_progress(", ".join(run.name for run in shown)):
        figures = page.write(shown, target)
    names = [run.name for run in shown]
    text = columns(differences.table(names, figures), numbers=True) if figures else []
    show({"report": str(target), "figures": figures}, lambda: "\n".join([*text, str(target)]), as_json=as_json)


def after_run(recording: Path, summary: dict[str, Any]) -> str:
    """Write report.html into the folder of a run at its end; return the line to print: its path or the failure.

    A failure here does not change the exit code of the run.
    """
    from ltv_mpc.errors import ConfigError
    from services.reporting import report as page
    from services.reporting.static_files import NoPlotly
    from services.reporting.terminal import reading_progress
    from services.run import folder

    target = recording.with_name(folder.REPORT)
    try:
        with reading_progress(folder.REPORT):
            page.write([page.Run(name=recording.parent.name, recording=recording, summary=summary)], target)
    except (ConfigError, NoPlotly, OSError) as error:
        return f"no {folder.REPORT}: {error}"
    return f"report: {target}"


def _names(recordings: Sequence[Path]) -> list[str]:
    """Return the names of the runs' folders, or their full paths if two names are equal."""
    names = [path.absolute().parent.name if path.name == "run.mcap" else path.stem for path in recordings]
    return names if len(set(names)) == len(names) else [str(path) for path in recordings]


def _target(recordings: Sequence[Path], out: Path | None, *, force: bool) -> Path:
    from services.run import folder

    if out is None and len(recordings) == 1:
        return recordings[0].with_name(folder.REPORT)
    out = out or folder.make_default("report")
    target = out if out.suffix == ".html" else out / folder.REPORT
    if target.exists() and not force:
        raise invalid("option --out", "exists: name another, or add --force", value=str(target))
    target.parent.mkdir(parents=True, exist_ok=True)
    return target


def replay(
    run: Annotated[str, argument("RUN", "Folder of a run, its run.mcap, or latest.")],
    with_: Annotated[
        Path | None, option("FILE", "Compare with other settings, a file such as RUN/config/controller.toml.", "--with")
    ] = None,
    node: Annotated[
        str | None, option("NAME", "Replay this node only: plant, sensors, estimator or controller.")
    ] = None,
    as_json: Json = False,
) -> int:
    """Replay a run byte for byte, or with other settings.

    Builds the nodes from the settings of the run, feeds them the recorded inputs in the recorded order and compares
    every output; with --with it reports the differences that other settings make. Exit code 0 if every step that can
    be compared is identical.
    """
    from services.replay import replay as again
    from services.replay.nodes import Run
    from services.reporting import replay_text
    from services.reporting.terminal import reading_progress
    from services.run import folder

    recording = folder.find(run)
    if with_ is not None:
        with reading_progress(recording):
            would = again.what_if(Run(recording), with_, only=node)
        show(would, lambda: replay_text.what_if_text(would), as_json=as_json)
        return 0
    with reading_progress(recording):
        verdict = again.replay(Run(recording), only=node)
    show(verdict, lambda: replay_text.text(verdict), as_json=as_json)
    return 0 if verdict.identical else 1


log = group("log", "Inspect, recover or export the recording of a run.")

RecordedRun: TypeAlias = Annotated[str, argument("RUN", "Recorded run: its folder, its run.mcap, or latest.")]


@log.command()
def info(run: RecordedRun = "latest", as_json: Json = False) -> int:
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
    run: RecordedRun = "latest",
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
    run: RecordedRun = "latest",
    form: Annotated[Literal["csv", "parquet"], flag("--format", "Format of the tables.")] = "csv",
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
    if form == "parquet":
        tables.need_pyarrow()
    place = folder.open_folder(out or recording.parent / form, force=force)
    from services.reporting import log_text
    from services.reporting.terminal import reading_progress

    with reading_progress(f"{recording} as {form}, twice"):
        result = tables.export(parts, place, form)
    show(result, lambda: f"{log_text.exported(result)}\n{place}", as_json=as_json)
