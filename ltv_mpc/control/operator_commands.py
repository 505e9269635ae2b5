"""Operator commands: who commands the thrusters, and which reference is followed."""

from __future__ import annotations

from ltv_mpc import config as settings
from ltv_mpc.control.controller import Controller
from ltv_mpc.control.estimate_sources import EstimateSources
from ltv_mpc.errors import ConfigError
from ltv_mpc.messages import Acknowledgement, Action, Authority, Command, Estimate
from ltv_mpc.references import Hold, Reference, Timed
from ltv_mpc.safety.command_arbiter import CommandArbiter, CommandResult

MAX_HOLD_DEPTH_M = 11_000.0
"""Upper bound of a reference's ``depth_m``."""

MAX_TOML_CHARS = 65_536
"""Longest reference in a saved state, as message validation allows. A longer one was read from a file, and a new
process reads the same file."""


class OperatorCommands:
    """Execution of an operator's commands, and the reference that they chose."""

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
        self._reference = reference
        self.reference_toml = reference_toml(reference)
        """Reference that is followed, as a reference file holds it; empty if it is longer than MAX_TOML_CHARS."""
        self.arm_continues = False
        """The next arm continues the reference, because a restart and no operator has disarmed."""

    def acknowledge(self, command: Command, t_ns: int) -> Acknowledgement:
        """Execute a command.

        Parameters
        ----------
        command : what the operator asks for.
        t_ns : now, vehicle time (ns).

        Returns
        -------
        The acknowledgement; it gives the reason if the command was rejected.
        """
        result = self._execute(command, t_ns)
        return Acknowledgement(
            t_ns=t_ns,
            command_id=command.command_id,
            accepted=not result.why,
            authority=result.authority,
            why=result.why,
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
        try:
            reference: Reference = settings.parse(settings.loads(toml), Reference, source="reference")  # type: ignore[arg-type]
        except ConfigError as error:
            return self._reject(str(error))
        except (ValueError, RecursionError) as error:
            return self._reject(f"reference: is not valid TOML: {error}")
        if isinstance(reference, Timed) and reference.file:
            return self._reject("reference: file: a message cannot name a file: give rows instead")
        self._set_reference(reference, toml)
        return self._arbiter.request(Action.FOLLOW)

    def _execute(self, command: Command, t_ns: int) -> CommandResult:
        if command.action is Action.FOLLOW:
            return self.follow(command.reference_toml)
        if command.action is Action.HOLD:
            return self._hold(self._sources.newest)
        if command.action is Action.SOURCE:
            return self._reject(self._sources.selector.force(command.source, t_ns))
        before = self._arbiter.authority
        result = self._arbiter.request(command.action)
        if result.why:
            return result
        if command.action is Action.ARM and before is not Authority.CONTROLLER and not self.arm_continues:
            # A reference that begins "here" begins where the vehicle is armed, not where it was put into the water.
            self._controller.follow(self._reference)
        self.arm_continues = False
        return result

    def _hold(self, estimate: Estimate | None) -> CommandResult:
        if estimate is None:
            return self._reject(
                "no estimate received yet, so the current position is unknown: retry after the first estimate"
            )
        depth_m = None if estimate.depth_m is None else min(max(estimate.depth_m, 0.0), MAX_HOLD_DEPTH_M)
        hold = Hold(depth_m=depth_m)
        self._set_reference(hold, reference_toml(hold))
        return self._arbiter.request(Action.HOLD)

    def _reject(self, why: str) -> CommandResult:
        """Return the unchanged authority with the reason of a rejection, if there is one."""
        return CommandResult(self._arbiter.authority, why)

    def _set_reference(self, reference: Reference, toml: str) -> None:
        self._reference, self.reference_toml = reference, toml
        self.arm_continues = False
        self._controller.follow(reference)


def reference_toml(reference: Reference) -> str:
    """Return a reference as a reference file holds it; empty if that is longer than MAX_TOML_CHARS."""
    text = settings.to_toml(reference)
    return text if len(text) <= MAX_TOML_CHARS else ""
