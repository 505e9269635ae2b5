"""Command ``completion``: completion of commands and options in the shell."""

from __future__ import annotations

from typing import Annotated

import typer

from services.cli.options import flag


def completion(
    context: typer.Context, install: Annotated[bool, flag("--install", "Add it to the shell's start-up file.")] = False
) -> None:
    """Print or install the completion script of your shell.

    The shell is the one that runs the command: bash, zsh, fish or PowerShell.
    """
    option = "--install-completion" if install else "--show-completion"
    context.find_root().command.main([option], prog_name="ltv-mpc")
