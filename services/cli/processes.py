"""One process each: what ``sim`` starts, alone in a terminal, in any order."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from services.cli.inject import inject
from services.cli.options import (
    Certs,
    Connect,
    Force,
    Listen,
    Mode,
    Namespace,
    Out,
    ScenarioName,
    SensorsFile,
    VehicleFile,
    ZenohConfig,
    bus,
)


def register(app: typer.Typer, panel: str) -> None:
    """Add the commands to their panel."""
    for command in (router, plant, sensors, estimator, recorder, inject):
        app.command(rich_help_panel=panel)(command)


def router(
    connect: Connect = None,
    listen: Listen = None,
    mode: Mode = None,
    config: ZenohConfig = None,
    namespace: Namespace = "",
    certs: Certs = None,
) -> int:
    """The router that all others connect to.

    Without --listen it listens at tcp/127.0.0.1:7447.
    """
    options = bus(connect, listen, mode, config, namespace, certs, role="router")
    from services.nodes import router as node

    return node.main(options)


def plant(
    scenario: ScenarioName = "descent",
    expect: Annotated[
        list[str] | None,
        typer.Option("--expect", metavar="NODE", help="Also wait for this one to be ready, as recorder; repeatable."),
    ] = None,
    connect: Connect = None,
    listen: Listen = None,
    mode: Mode = None,
    config: ZenohConfig = None,
    namespace: Namespace = "",
    certs: Certs = None,
) -> int:
    """The simulated vehicle, which keeps vehicle time.

    Reads plan; writes world/truth, applied and clock. Starts when sensors, estimator and controller are ready.
    """
    from services.run.situation import resolve

    situation = resolve(scenario)
    options = bus(connect, listen, mode, config, namespace, certs, role="plant")
    from services.nodes import plant as node

    return node.main(situation, options, expects=tuple(expect or ()))


def sensors(
    scenario: ScenarioName = "descent",
    connect: Connect = None,
    listen: Listen = None,
    mode: Mode = None,
    config: ZenohConfig = None,
    namespace: Namespace = "",
    certs: Certs = None,
) -> int:
    """The simulated sensors.

    Reads world/truth; writes sensor/*.
    """
    from services.run.situation import resolve

    situation = resolve(scenario)
    options = bus(connect, listen, mode, config, namespace, certs, role="sensors")
    from services.nodes import sensors as node

    return node.main(situation, options)


def estimator(
    vehicle: VehicleFile = "paper",
    sensors: SensorsFile = "paper",
    settings: Annotated[
        Path | None, typer.Option("--settings", metavar="FILE", help="The [estimator] table alone, as TOML.")
    ] = None,
    connect: Connect = None,
    listen: Listen = None,
    mode: Mode = None,
    config: ZenohConfig = None,
    namespace: Namespace = "",
    certs: Certs = None,
) -> int:
    """The localisation filter.

    Reads sensor/*; writes estimate.
    """
    from ltv_mpc.localisation.config import EstimatorConfig
    from ltv_mpc.localisation.suite import Suite
    from ltv_mpc.vehicle.parameters import Vehicle
    from services.run.water import beside, told

    Vehicle.load(vehicle)
    suite = Suite.load(sensors)
    table = EstimatorConfig() if settings is None else beside(settings.parent, EstimatorConfig.load(str(settings)))
    prior = told(table)
    options = bus(connect, listen, mode, config, namespace, certs, role="estimator")
    from services.nodes import estimator as node

    return node.main(suite, table, options, prior=prior)


def recorder(
    scenario: ScenarioName = "descent",
    out: Out = None,
    force: Force = False,
    goes_on: Annotated[
        bool, typer.Option("--continue", help="Go on in --out of this scenario, with the next segment: run.2.mcap.")
    ] = False,
    connect: Connect = None,
    listen: Listen = None,
    mode: Mode = None,
    config: ZenohConfig = None,
    namespace: Namespace = "",
    certs: Certs = None,
) -> int:
    """Records every message into one folder.

    Reads everything; run.mcap opens in Foxglove.
    """
    from services.run import folder
    from services.run.situation import resolve

    situation = resolve(scenario)
    options = bus(connect, listen, mode, config, namespace, certs, role="recorder")
    run_folder = None if out is None else folder.made_for(Path(scenario), out, goes_on=goes_on)
    if run_folder is None:
        run_folder = folder.make(situation.name, situation.files, out=out, force=force)
    from services.nodes import recorder as node

    scenario_ = situation.scenario
    metadata = {"mode": "services", "seed": str(scenario_.run.seed), **situation.files}
    return node.main(run_folder.path, options, start_ns=scenario_.start_ns, metadata=metadata)
