"""Which processes a run is made of, in the order of their start: the only place where that is said."""

from __future__ import annotations

from collections.abc import Mapping

import msgspec

from sim.scenario import Scenario


class Process(msgspec.Struct, frozen=True):
    """One row. The command is what a person would type after ``ltv-mpc``, with the names of ``places`` in braces.

    ``restartable``: its death need not end a run; of the others' the run dies. ``needs`` must be ready before it
    starts: the recorder comes first, so that nothing is said before it listens.
    """

    name: str
    command: tuple[str, ...]
    restartable: bool
    needs: tuple[str, ...]


BUS = ("--connect", "{router}", "--namespace", "{namespace}")
SCENARIO = "{run}/scenario.toml"

PROCESSES = (
    Process("router", ("--listen", "{router}", "--namespace", "{namespace}"), True, ()),
    Process("recorder", (SCENARIO, "--out", "{run}", "--continue", *BUS), True, ()),
    Process("plant", (SCENARIO, "--expect", "recorder", *BUS), False, ("recorder",)),
    Process("sensors", (SCENARIO, *BUS), False, ("recorder",)),
    Process(
        "estimator",
        (
            *("--vehicle", "{run}/config/vehicle.toml", "--sensors", "{run}/config/sensors.toml"),
            *("--settings", "{run}/config/estimator.toml", *BUS),
        ),
        True,
        ("recorder",),
    ),
    Process(
        "controller",
        (
            *("--vehicle", "{run}/config/vehicle.toml", "--reference", "{run}/config/reference.toml"),
            *("--settings", "{run}/config/controller.toml", "--compute-delay-s", "{compute_delay_s}"),
            *("--failed-qps", "{run}/failed-qps", *BUS),
        ),
        True,
        ("recorder",),
    ),
)


def processes(scenario: Scenario) -> tuple[Process, ...]:
    """The rows that a scenario needs: with the truth given away there is nothing to estimate."""
    return tuple(row for row in PROCESSES if not (row.name == "estimator" and scenario.run.perfect_state))


def command(row: Process, places: Mapping[str, str]) -> list[str]:
    """The command line of a row, its places filled in; with certificates where ``places`` has a folder of them."""
    secured = ("--certs", "{certs}") if "certs" in places else ()
    return [row.name, *(word.format_map(places) for word in (*row.command, *secured))]
