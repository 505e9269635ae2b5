"""Operator commands: who commands the thrusters, which reference and which fence hold, and the end of a mission.

Reports of obstacles arrive here, too, and the fence in force is published.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ltv_mpc import config as settings
from ltv_mpc.control.controller import Controller
from ltv_mpc.control.estimate_sources import EstimateSources
from ltv_mpc.control.pre_arm import Failure
from ltv_mpc.errors import ConfigError
from ltv_mpc.geofence.fence import Fence
from ltv_mpc.messages import (
    Acknowledgement,
    Action,
    Authority,
    Command,
    Estimate,
    FenceInForce,
    Health,
    MissionAction,
    Obstacles,
)
from ltv_mpc.references import Hold, Reference, Timed
from ltv_mpc.safety.command_arbiter import CommandArbiter, CommandResult
from ltv_mpc.safety.health import NOMINAL, HealthState
from ltv_mpc.safety.mission_policy import MissionPolicy

MAX_TOML_CHARS = 65_536
"""Longest reference or fence in a saved state, as message validation allows. A longer one was read from a file, and
a new process reads the same file."""


class OperatorCommands:
    """Execution of an operator's commands, and the reference and the fence that they chose."""

    def __init__(
        self, controller: Controller, arbiter: CommandArbiter, sources: EstimateSources, reference: Reference
    ) -> None:
        """Begin with the reference that the controller was started with.

        Parameters
        ----------
        controller : follows the chosen reference.
        arbiter : decides who commands the thrusters.
        sources : of the estimates; "hold" means the depth of the newest one.
        reference : the one that ``controller`` follows now.
        """
        self._controller = controller
        self._arbiter = arbiter
        self._sources = sources
        self.mission = MissionPolicy(controller.config.mission)
        """Policy that ends the mission."""
        self.fence = FencePublisher(controller)
        """Fence and obstacles as messages."""
        self.reference = reference
        """Reference that is followed."""
        self.reference_toml = toml_text(reference)
        """The same, as a reference file holds it; empty if it is longer than MAX_TOML_CHARS."""
        self.fence_toml = "" if controller.fence is None else toml_text(controller.fence)
        """Fence in force, as a fence file holds it; empty without one, or if it is longer than MAX_TOML_CHARS."""
        self.arm_continues = False
        """The next arm continues the reference, because a restart and no operator has disarmed."""

    def acknowledge(self, command: Command, t_ns: int, checks: Callable[[], list[Failure]]) -> Acknowledgement:
        """Execute a command.

        Parameters
        ----------
        command : what the operator asks for.
        t_ns : now, vehicle time (ns).
        checks : runs the pre-arm checks.

        Returns
        -------
        The acknowledgement; it gives the reason if the command was rejected.
        """
        warnings: list[str] = []
        if command.action is Action.ARM and self._arbiter.authority in (Authority.DISARMED, Authority.STOPPED):
            result = self._arm(checks(), t_ns, warnings, force=command.force)
        else:
            result = self._execute(command, t_ns)
        if not result.why and self.mission.state.action is not MissionAction.GO_ON:
            warnings.append(f"{self.mission.health(t_ns).why}: `clear` ends this when its cause is gone")
        return Acknowledgement(
            t_ns=t_ns,
            command_id=command.command_id,
            accepted=not result.why,
            authority=result.authority,
            why=result.why,
            warnings=tuple(warnings),
        )

    def follow(self, toml: str) -> CommandResult:
        """Follow the reference that a TOML text describes.

        Parameters
        ----------
        toml : text of a reference file; one that reads another file is rejected.

        Returns
        -------
        The authority, and the reason if the text was rejected.
        """
        reference = _parsed(toml, Reference, "reference")
        if isinstance(reference, str):
            return self._reject(reference)
        if isinstance(reference, Timed) and reference.file:
            return self._reject("reference: file: a message cannot name a file: give rows instead")
        try:
            self._set_reference(reference, toml)
        except ConfigError as error:
            return self._reject(str(error))
        return self._arbiter.request(Action.FOLLOW)

    def set_fence(self, toml: str) -> CommandResult:
        """Keep the fence that a TOML text describes; if it is rejected, the one in force stays.

        Parameters
        ----------
        toml : text of a fence file; empty: no fence.

        Returns
        -------
        The authority, and the reason if the text was rejected.
        """
        fence = _parsed(toml, Fence, "fence") if toml else None
        if isinstance(fence, str):
            return self._reject(fence)
        try:
            self._controller.set_fence(fence)
        except ConfigError as error:
            return self._reject(str(error))
        self.fence_toml = toml
        return self._arbiter.request(Action.FENCE)

    def _arm(self, failures: list[Failure], t_ns: int, warnings: list[str], *, force: bool) -> CommandResult:
        """Arm if no pre-arm check fails, or by force; append to ``warnings`` what was skipped."""
        blocking = [failure.text for failure in failures if failure.blocks]
        if blocking and not force:
            return self._reject(f"pre-arm checks failed (`ltv-mpc ctl arm --force` skips them): {'; '.join(blocking)}")
        warnings += [f"{'skipped' if failure.blocks else 'warning'}: {failure.text}" for failure in failures]
        self.mission.arm(t_ns)
        if not self.arm_continues:
            # A reference that begins "here" begins where the vehicle is armed, not where it was put into the water.
            self._controller.follow(self.reference)
        self.arm_continues = False
        return self._arbiter.request(Action.ARM)

    def _execute(self, command: Command, t_ns: int) -> CommandResult:
        match command.action:
            case Action.FOLLOW:
                result = self.follow(command.reference_toml)
                if not result.why:
                    self.mission.restart(t_ns)
                return result
            case Action.FENCE:
                return self.set_fence(command.fence_toml)
            case Action.HOLD:
                return self._hold(self._sources.newest)
            case Action.SOURCE:
                return self._reject(self._sources.selector.force(command.source, t_ns))
            case Action.CLEAR if why := self.mission.clear(t_ns):
                return self._reject(f"the cause is still present: {why}: end it, or `disarm`")
        result = self._arbiter.request(command.action)
        if result.why or command.action is Action.CLEAR:
            return result
        self.arm_continues = False
        if not self._arbiter.armed:
            self.mission.disarm()
        return result

    def _hold(self, estimate: Estimate | None) -> CommandResult:
        if estimate is None:
            return self._reject(
                "no estimate received yet, so the current position is unknown: retry after the first estimate"
            )
        hold = Hold.at_depth_of(estimate)
        self._set_reference(hold, toml_text(hold))
        return self._arbiter.request(Action.HOLD)

    def _reject(self, why: str) -> CommandResult:
        """Return the unchanged authority with the reason of a rejection, if there is one."""
        return CommandResult(self._arbiter.authority, why)

    def _set_reference(self, reference: Reference, toml: str) -> None:
        self._controller.follow(reference)
        self.reference, self.reference_toml = reference, toml
        self.arm_continues = False


def toml_text(settled: Reference | Fence) -> str:
    """Return a reference or a fence as its file holds it; empty if that is longer than MAX_TOML_CHARS."""
    text = settings.to_toml(settled)
    return text if len(text) <= MAX_TOML_CHARS else ""


def _parsed(toml: str, kind: Any, source: str) -> Any:
    """Return what a TOML text describes, or the reason why it describes nothing."""
    try:
        return settings.parse(settings.loads(toml), kind, source=source)
    except ConfigError as error:
        return str(error)
    except (ValueError, RecursionError) as error:
        return f"{source}: is not valid TOML: {error}"


OBSTACLES_PERIOD_NS, FENCE_PERIOD_NS = 1_000_000_000, 10_000_000_000
"""Times between two publications: with obstacles, and with a fence alone."""


class FencePublisher:
    """Publisher of a controller's fence and obstacles; it publishes nothing while there are none."""

    def __init__(self, controller: Controller) -> None:
        """Begin with nothing published.

        Parameters
        ----------
        controller : keeps the fence, and avoids the obstacles.
        """
        self._controller = controller
        self._fence: Fence | None = None  # published last
        self._obstacles = False  # there were some in the last publication, or one has arrived since
        self._published_ns: int | None = None
        self.health: HealthState = NOMINAL
        """Degraded if obstacles arrive that the controller cannot avoid."""

    def receive(self, obstacles: Obstacles) -> None:
        """Avoid obstacles, if the vehicle file allows it.

        Parameters
        ----------
        obstacles : reports of some or all obstacles.
        """
        try:
            self._controller.add_obstacles(obstacles)
        except ConfigError as error:
            self.health = HealthState(Health.DEGRADED, f"obstacles are not avoided: {error}")
            return
        if not self._obstacles:
            self._obstacles, self._published_ns = True, None

    def due(self, t_ns: int) -> FenceInForce | None:
        """Return the message if it is due: at a change of the fence, at the first obstacle, then from time to time.

        Parameters
        ----------
        t_ns : current time, vehicle time (ns).
        """
        fence = self._controller.fence
        period_ns = OBSTACLES_PERIOD_NS if self._obstacles else FENCE_PERIOD_NS
        recently = self._published_ns is not None and 0 <= t_ns - self._published_ns < period_ns
        if fence is self._fence and (recently or (fence is None and not self._obstacles)):
            return None
        report = self._controller.fence_in_force(t_ns)
        self._fence, self._obstacles, self._published_ns = fence, bool(report.obstacles), t_ns
        return report
