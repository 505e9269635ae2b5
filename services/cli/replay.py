"""Command ``replay``: compute every output of a recorded run again."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from services.cli.options import Json, argument, option, show


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
    from services.replay import replay as nodes
    from services.reporting import replay_text
    from services.reporting.terminal import run_progress_bar
    from services.run import folder

    made = nodes.Run(folder.find(run))
    with run_progress_bar(*made.nodes.span_ns) as progress:
        if with_ is not None:
            would = nodes.what_if(made, with_, only=node, progress=progress)
        else:
            verdict = nodes.replay(made, only=node, progress=progress)
    if with_ is not None:
        show(would, lambda: replay_text.what_if_text(would), as_json=as_json)
        return 0
    show(verdict, lambda: replay_text.text(verdict), as_json=as_json)
    return 0 if verdict.identical else 1
