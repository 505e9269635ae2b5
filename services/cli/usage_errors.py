"""Errors of the command line itself, in the words of every other error: the option, its value and its bound.

The command-line library raises its own errors for unknown commands and options, missing and invalid values. All of
them pass through ``usage_error``. What they lack is found in the arguments and in the tree of the commands.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, get_args

from msgspec import Meta, inspect
from typer.core import TyperOption

from ltv_mpc.config import number_or_text
from ltv_mpc.errors import ConfigError, format_value
from ltv_mpc.settings_schema import closest_name, expected


def usage_error(error: Exception, tree: Any, arguments: Sequence[str]) -> ConfigError:
    """Return the error that names the command's option or argument, its value, its bound, and the help to read.

    Parameters
    ----------
    error : of the command-line library.
    tree : group of all commands.
    arguments : command line, without the program.
    """
    command, path, rest = _command(tree, arguments)
    see = f"`{path} --help` {'lists the commands' if hasattr(command, 'commands') else 'describes the command'}"
    option = getattr(error, "option_name", None)
    parameter = getattr(error, "param", None)
    if parameter is not None:
        return _of_value(error, parameter, see)
    if option is not None:
        return _of_option(option, command, arguments, see)
    if hasattr(command, "commands") and rest:
        return ConfigError(f"command {format_value(rest[0])}", "", f"unknown{_near(rest[0], command.commands, see)}")
    surplus = rest and str(error).rpartition("(")[2].rstrip(").")
    if surplus and surplus in " ".join(rest):
        takes = " ".join(_label(one) for one in command.params if not isinstance(one, TyperOption)) or "none"
        return ConfigError("argument", "", f"is not expected; `{path}` takes: {takes}", value=surplus)
    return ConfigError(path, "", f"{str(error).rstrip('.')}; {see}")


def _command(tree: Any, arguments: Sequence[str]) -> tuple[Any, str, list[str]]:
    """Return the command that the arguments name, its path, and the arguments after it; options of groups are none."""
    command, path = tree, "ltv-mpc"
    rest = list(arguments)
    while hasattr(command, "commands"):
        words = [argument for argument in rest if not argument.startswith("-")]
        if not words or words[0] not in command.commands:
            return command, path, words
        command, path, rest = command.commands[words[0]], f"{path} {words[0]}", rest[rest.index(words[0]) + 1 :]
    return command, path, rest


def _of_value(error: Exception, parameter: Any, see: str) -> ConfigError:
    """Return the error of a value that is missing or invalid."""
    source = f"{parameter.param_type_name} {_label(parameter)}"
    details: list[Any] = getattr(error.__cause__, "errors", list)()
    if not details:
        return ConfigError(source, "", f"is missing; {see}")
    value = details[0]["input"]
    descriptor = parameter.type_descriptor
    if descriptor.choices:
        choices = [str(getattr(choice, "value", choice)) for choice in descriptor.choices]
        return ConfigError(source, "", f"must be one of {', '.join(choices)}{_near(value, choices)}", value=value)
    return ConfigError(source, "", f"must be {_bound(parameter, value)}", value=number_or_text(value))


def _bound(parameter: Any, value: str) -> str:
    """Describe the valid values of a number as every other error does."""
    annotation = parameter.type_descriptor.annotation
    kinds = get_args(annotation) or (annotation,)
    kind = next((kind for kind in (int, float) if kind in kinds), str)
    bounds = {name: bound for name, bound in (("ge", parameter.min), ("le", parameter.max)) if bound is not None}
    return expected(inspect.type_info(Annotated[kind, Meta(**bounds)]), number_or_text(value))


def _of_option(option: str, command: Any, arguments: Sequence[str], see: str) -> ConfigError:
    """Return the error of an option that is unknown, or whose value is missing or one too many."""
    known = {name: one for one in command.params for name in (*one.opts, *one.secondary_opts) if name.startswith("-")}
    written = next((text for text in arguments if text.startswith(option)), option)
    name, _, value = written.partition("=")
    if option not in known:
        return ConfigError(f"option {name}", "", f"unknown{_near(name, known, see)}")
    if known[option].is_flag:
        return ConfigError(f"option {option}", "", f"takes no value; {see}", value=value)
    return ConfigError(f"option {option}", "", f"needs a value, {known[option].metavar or 'TEXT'}; {see}")


def _label(parameter: Any) -> str:
    """Return what the help calls a parameter: its longest option, or the argument's name."""
    if isinstance(parameter, TyperOption):
        return str(max(parameter.opts, key=len))
    return str(parameter.metavar or parameter.name.upper())


def _near(name: str, names: Any, otherwise: str = "") -> str:
    meant = closest_name(name, [one for one in names if one != "--help"] or names)
    if meant is not None:
        return f"; did you mean {format_value(meant)}?"
    return f"; {otherwise}" if otherwise else ""
