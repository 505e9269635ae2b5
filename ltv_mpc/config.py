"""Settings files: a TOML table becomes a frozen struct, or an error that names file, field, value and bound."""

from __future__ import annotations

import codecs
import json
import math
import os
import re
import stat
import tomllib
from collections import Counter
from collections.abc import Iterator, Mapping
from importlib import resources
from pathlib import Path, PurePath
from typing import Any, BinaryIO, TypeVar

import msgspec
import tomli_w

from ltv_mpc import settings_schema
from ltv_mpc.errors import ConfigError, format_value, naming

T = TypeVar("T")

MAX_FILE_BYTES = 1 << 20
"""Largest size of a settings file."""

MAX_NESTING = 10
"""Largest depth of nested tables and lists. No settings file needs more, and their traversal is recursive."""

FOREIGN = {".kml": "KML", ".kmz": "KML", ".dxf": "DXF", ".gml": "GML", ".shp": "a shapefile", ".gpkg": "GeoPackage"}
"""Kinds of files of maps, by their suffix, that GDAL's ogr2ogr converts."""

TOO_DEEP = f"tables and lists inside one another: at most {MAX_NESTING} deep"


def parse(table: Mapping[str, Any], kind: type[T], *, source: str) -> T:
    """Convert a TOML table to a struct.

    Parameters
    ----------
    table : content of the file.
    kind : frozen msgspec Struct.
    source : name of the file in errors, ``scenario descent.toml``.

    Raises
    ------
    ConfigError
        For unknown keys (with the nearest known name), missing keys, wrong types, values outside their bounds, and
        numbers that are not finite.
    """
    for path, value in _scalars(table, (), source):
        if isinstance(value, float) and not math.isfinite(value):
            raise ConfigError(source, toml_key(path), "must be finite", value=value)
    try:
        return msgspec.convert(table, kind)
    except msgspec.ValidationError as error:
        raise _explained(str(error), table, kind, source) from None


def read_toml(path: Path, *, what: str) -> dict[str, Any]:
    """Read a TOML file.

    Parameters
    ----------
    path : file.
    what : kind of file for errors, "scenario" or "vehicle".

    Raises
    ------
    ConfigError
        If the file cannot be read or is not valid TOML.
    """
    source = f"{what} {path}"
    text = read_text(path, what=what)
    try:
        return loads(text)
    except RecursionError:
        raise ConfigError(source, "", TOO_DEEP) from None
    except ValueError as error:
        raise ConfigError(source, "", f"is not valid TOML: {error}") from None


_CHAIN = re.compile(rf"""(?<![\w-])(?:(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+\.[ \t]*+){{{MAX_NESTING}}}""")
"""Key of at least ``MAX_NESTING`` parts, a.a.a... The time of tomllib grows with the square of their number: half a
minute for 64 kB.
"""


def loads(text: str) -> dict[str, Any]:
    """Parse TOML text in a time that grows linearly with its length.

    Raises
    ------
    ValueError
        If the text is not valid TOML.
    RecursionError
        If tables or keys are nested too deeply.
    """
    if _CHAIN.search(text):
        raise RecursionError
    return tomllib.loads(text)


_XML = re.compile(
    rb"""<\?xml[^>]{,80}\sencoding=["'](iso-8859-(?:1[013-6]?|[2-9])|windows-125[0-8])["']""", re.IGNORECASE
)
"""Declaration of another encoding than Unicode."""


def read_text(path: Path, *, what: str, errors: str = "strict") -> str:
    """Read the text of a settings file: UTF-8, UTF-16 with its mark, or what XML declares.

    Parameters
    ----------
    path : file.
    what : kind of file for errors.
    errors : as ``bytes.decode`` takes it.

    Raises
    ------
    ConfigError
        If the file is missing, no regular file, too large, empty, or no UTF-8 text. The error says what to do.
    """
    source = f"{what} {path}"
    if foreign := FOREIGN.get(path.suffix.lower()):
        raise ConfigError(source, "", f"is {foreign}: convert it, as with ogr2ogr {path.stem}.geojson {path.name}")
    content = read_bytes(path, what=what)
    try:
        is_utf_16 = content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
        declared = _XML.match(content)
        text = content.decode("utf-16" if is_utf_16 else declared[1].decode() if declared else "utf-8-sig", errors)
    except UnicodeDecodeError as error:
        problem = f"is not UTF-8 text (byte {error.start}): save it as UTF-8, or check that it is the right file"
        raise ConfigError(source, "", problem) from None
    if not text.strip():
        raise ConfigError(source, "", "is empty")
    if "\0" in text:
        raise ConfigError(source, "", "holds binary data, not text: check that it is the right file")
    return text


def open_file(path: Path, *, what: str, max_bytes: int | None = None) -> BinaryIO:
    """Open a regular file. Every reader of a file that a user names uses this: a fifo or a device cannot stop it.

    Parameters
    ----------
    path : file.
    what : kind of file for errors.
    max_bytes : largest size (bytes); None: any.

    Raises
    ------
    ConfigError
        If the file is missing, no regular file, or too large. The error says what to do.
    """
    source = f"{what} {path}"
    try:
        number = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    except FileNotFoundError:
        raise ConfigError(source, "", missing_file_hint(path)) from None
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        why = getattr(error, "strerror", None) or str(error)
        raise ConfigError(source, "", f"cannot be read: {why}") from None
    status = os.fstat(number)
    problem = ""
    if stat.S_ISDIR(status.st_mode):
        problem = f"is a folder: give the {what} file itself"
    elif not stat.S_ISREG(status.st_mode):
        problem = "is not a regular file"
    elif max_bytes is not None and status.st_size > max_bytes:
        problem = f"has {status.st_size} bytes: at most {max_bytes}; check the file name"
    if problem:
        os.close(number)
        raise ConfigError(source, "", problem)
    return os.fdopen(number, "rb")


def read_bytes(path: Path, *, what: str, max_bytes: int = MAX_FILE_BYTES) -> bytes:
    """Read a regular file of limited size: ``open_file``.

    Parameters
    ----------
    path : file.
    what : kind of file for errors.
    max_bytes : largest size (bytes).
    """
    with open_file(path, what=what, max_bytes=max_bytes) as file:
        try:
            return file.read(max_bytes)  # a file of /proc has no size
        except OSError as error:
            raise ConfigError(f"{what} {path}", "", f"cannot be read: {error.strerror}") from None


def parse_json(text: str | bytes, source: str) -> dict[str, Any]:
    """Return the object of a JSON text.

    Parameters
    ----------
    text : content of a file.
    source : name of the file in errors.

    Raises
    ------
    ConfigError
        If it is no JSON object, has a key twice in one object, or an integer of more than 64 bits.
    """
    with naming(source, "", "is not a JSON object: ", OverflowError, RecursionError):
        found = msgspec.json.decode(text, type=dict[str, Any])
        msgspec.msgpack.encode(found)  # raises for an integer of more than 64 bits
        json.loads(text, object_pairs_hook=_check_keys)
        return found


def _check_keys(pairs: list[tuple[str, Any]]) -> None:
    """Raise ``ValueError`` if a key of an object of JSON occurs twice: parsers keep one of its values."""
    if len(dict(pairs)) < len(pairs):
        ((key, count),) = Counter(key for key, _ in pairs).most_common(1)
        raise ValueError(f"key {format_value(key)} occurs {count} times in one object")


def missing_file_hint(path: Path) -> str:
    """Describe a missing file: the similar name in its folder, or the missing folder."""
    folder = path.parent
    try:
        names = [file.stem for file in folder.iterdir() if file.suffix == path.suffix]
    except OSError:
        return f"no such file: there is no folder {folder}"
    if meant := settings_schema.closest_name(path.stem, names):
        return f"no such file; did you mean {folder / meant}{path.suffix}?"
    return "no such file: name an existing file"


def number_or_text(text: str) -> int | float | str:
    """Return the number that a text of the command line is, or the text.

    Parameters
    ----------
    text : value of an option or argument, or a part of it.
    """
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


def is_path(name: str) -> bool:
    """Return True if NAME|FILE is a path: it has a suffix or a slash. A bare name means a shipped file.

    A suffix begins with a letter: ``paper-2.5s`` has none.
    """
    return "/" in name or "\\" in name or PurePath(name).suffix[1:2].isalpha()


def find(name: str, *, what: str, package: str | None) -> Path:
    """Return the path of NAME|FILE.

    Parameters
    ----------
    name : bare name of a shipped file, or a path with a suffix or a slash.
    what : kind of file for errors.
    package : package whose folder holds the shipped files; None if no file of this kind is shipped.

    Raises
    ------
    ConfigError
        If no shipped file has this name. The error lists the shipped names.
    """
    if is_path(name):
        return Path(name)
    files = {} if package is None else {path.stem: path for path in _shipped(package)}
    if name in files:
        return files[name]
    hints = ["no shipped name"]
    if files:
        hints.append(f"shipped: {', '.join(sorted(files))}")
    if name not in ("", "..") and Path(name).is_file():
        hints.append(f"for the file here write ./{name}")
    elif meant := settings_schema.closest_name(name, files):
        hints.append(f"did you mean {format_value(meant)}?")
    else:
        hints.append("a file has a suffix or a slash")
    raise ConfigError(f"{what} {format_value(name)}", "", "; ".join(hints))


def load(name: str, kind: type[T], *, what: str, package: str | None) -> T:
    """Find, read and parse a settings file.

    Parameters
    ----------
    name : bare name of a shipped file, or a path.
    kind : frozen msgspec Struct.
    what : kind of file for errors.
    package : package whose folder holds the shipped files; None if no file of this kind is shipped.

    Raises
    ------
    ConfigError
        As ``find``, ``read_toml`` and ``parse``.
    """
    path = find(name, what=what, package=package)
    return parse(read_toml(path, what=what), kind, source=error_source(path, what=what, name=name))


def to_toml(settings: msgspec.Struct) -> str:
    """Format a struct as TOML text that ``parse`` reads back bitwise. None is left out."""
    return tomli_w.dumps(_without_none(msgspec.to_builtins(settings)))


def error_source(path: Path, *, what: str, name: str) -> str:
    """Return the name of a file in errors: as the user wrote it; of a shipped file its file name.

    Parameters
    ----------
    path : file.
    what : kind of file.
    name : NAME|FILE as the user wrote it.
    """
    return f"{what} {path if is_path(name) else path.name}"


def toml_key(path: settings_schema.Path) -> str:
    """Format ``("thruster", "port", "arm_m")`` as TOML table and key, ``[thruster.port] arm_m``."""
    keys = list(path)
    tables: list[str] = []
    while len(keys) > 1 and isinstance(keys[0], str) and isinstance(keys[1], str):
        tables.append(str(keys.pop(0)))
    key = "".join(f"[{k}]" if isinstance(k, int) else f".{k}" for k in keys).removeprefix(".")
    return f"[{'.'.join(tables)}] {key}" if tables else key


def _without_none(table: dict[str, Any]) -> dict[str, Any]:
    """Remove entries of value None: TOML has no null."""
    return {
        key: _without_none(value) if isinstance(value, dict) else value
        for key, value in table.items()
        if value is not None
    }


def _shipped(package: str) -> Iterator[Path]:
    parent, _, folder = package.rpartition(".")
    try:
        here = Path(str(resources.files(parent))) / folder
    except ModuleNotFoundError:
        return iter(())
    return here.glob("*.toml")


def _scalars(value: Any, path: tuple[str | int, ...], source: str) -> Iterator[tuple[settings_schema.Path, Any]]:
    """Iterate over all scalars in a tree of tables and lists, with their paths."""
    if len(path) > MAX_NESTING:
        raise ConfigError(source, toml_key(path[:1]), TOO_DEEP)
    if isinstance(value, Mapping):
        for key, inner in value.items():
            yield from _scalars(inner, (*path, str(key)), source)
    elif isinstance(value, (list, tuple)):
        for i, inner in enumerate(value):
            yield from _scalars(inner, (*path, i), source)
    else:
        yield path, value


_UNKNOWN = re.compile(r"Object contains unknown field `(.*)`", re.DOTALL)
_MISSING = re.compile(r"Object missing required field `(.*)`", re.DOTALL)
_OF_VALUE = ("Expected ", "Invalid ", "Number out of range", "Integer ")


def _explained(message: str, table: Mapping[str, Any], kind: Any, source: str) -> ConfigError:
    """Translate a msgspec error: add the value, all its bounds, and the name that was probably meant."""
    problem, path = split_error(message)
    within, value = settings_schema.look_up(kind, table, path)
    where = f" in [{'.'.join(str(x) for x in path)}]" if path else ""
    if unknown := _UNKNOWN.fullmatch(problem):
        near = settings_schema.suggestion(unknown[1], settings_schema.field_names(within))
        return ConfigError(source, "", f"unknown key {format_value(unknown[1])}{where}{near}")
    if missing := _MISSING.fullmatch(problem):
        inner, _ = settings_schema.look_up(kind, table, (*path, missing[1]))
        valid = settings_schema.tag_values(within) or settings_schema.expected(inner)
        return ConfigError(source, "", f"key {format_value(missing[1])}{where} is missing: must be {valid}")
    if problem.startswith(_OF_VALUE):
        outer = settings_schema.look_up(kind, table, path[:-1])[0] if path else None
        valid = settings_schema.tag_values(outer) or settings_schema.expected(within, value)
        return ConfigError(source, toml_key(path), f"must be {valid}", value=value)
    return ConfigError(source, toml_key(path), problem, value=None if isinstance(value, dict) else value)


def split_error(message: str) -> tuple[str, settings_schema.Path]:
    """Split ``Expected `float` >= 0.0 - at `$.water.sd_mps``` into (problem, ("water", "sd_mps"))."""
    problem, at, path = message.rpartition(" - at `$")
    if not at:
        return message, ()
    steps: list[str | int] = []
    for name, index in re.findall(r"\.([^.\[\]]+)|\[(\d+)\]", path.removesuffix("`").split("[...]")[0]):
        steps.append(name or int(index))
    return problem, steps
