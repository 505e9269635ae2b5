"""What each field of each message means, in words: for the protocol page, the schemas and ``ltv-mpc topics``.

Units and bounds are in ``ltv_mpc/ranges.py``. Where several messages have a field of one name it means one thing, said
once in ``EVERYWHERE``; ``OF`` says what is another thing in one message, or is in that message alone.
"""

from __future__ import annotations

from collections.abc import Mapping

EVERYWHERE: Mapping[str, str] = {
    "epoch": "which start of the sender this is: drawn at random by each start, so that no two are the same",
    "sequence": "which message of this key and epoch this is: from 0, one more each time",
    "sent_monotonic_us": "the sender's CLOCK_MONOTONIC at publication; 0 or left out: not said",
    "t_ns": "time of validity",
    "node": "who says it",
    "key": "of the message, without the namespace",
    "crc": "CRC-32 of the payload",
    "why": "in words; empty where there is nothing to say",
    "north_m": "position north of the origin",
    "east_m": "position east of the origin",
    "velocity_north_mps": "velocity over ground, north",
    "velocity_east_mps": "velocity over ground, east",
    "yaw_rate_radps": "rate of turn about the body's down axis, positive to starboard",
    "thrust_N": "port, starboard, vertical; positive: ahead, ahead, down",
    "depth_m": "depth below the surface",
    "text": "in words",
}

OF: Mapping[str, Mapping[str, str]] = {
    "Truth": {
        "position_m": "north, east, down",
        "velocity_mps": "over ground: north, east, down",
        "attitude_rad": "roll, pitch, heading",
        "water_velocity_mps": "relative to the water: surge, sway, heave, in the level frame of the heading",
        "current_mps": "water at the vehicle over ground: north, east",
        "thrust_N": "delivered: port, starboard, vertical",
    },
    "Applied": {
        "t_ns": "when this was so, and when it was sent",
        "thrust_N": "delivered, after lag and saturation: port, starboard, vertical",
        "command_N": "the command in force: port, starboard, vertical",
        "command_slew_N_per_s": "largest rate of change of the command since the last report; 0: not watched",
        "plan_epoch": "of the newest plan accepted; 0 before the first",
        "plan_sequence": "of the newest plan accepted; -1 before the first",
        "plan_cycle_t_ns": "cycle_t_ns of the newest plan accepted, copied; 0 before the first",
        "plan_received_t_ns": "when the newest plan accepted arrived; 0 before the first",
        "plan_late": "that plan arrived after its own first knot",
        "plans_late": "so many did so far",
        "plans_refused": "so many were not followed so far: outside box or slew limit, or out of order",
    },
    "ImuSample": {
        "t_ns": "end of the interval",
        "interval_ns": "its length",
        "angular_rate_radps": "mean over the interval: forward, starboard, down",
        "specific_force_mps2": "mean over the interval: forward, starboard, down",
    },
    "TdcpFix": {
        "from_t_ns": "the earlier epoch",
        "north_m": "change of position from then to t_ns, north",
        "east_m": "change of position from then to t_ns, east",
    },
    "AdcpPing": {
        "range_m": "slant range of each cell's centre, increasing",
        "beam_velocity_mps": "4 x K: of the water along each beam, positive away from the vehicle; null: no return",
    },
    "CompassHeading": {"heading_rad": "true heading, deviation and declination taken off"},
    "BottomTrack": {
        "range_m": "slant range to the bottom by beam; null: not found",
        "beam_velocity_mps": "of the bottom along each beam, positive away from the vehicle; null: not found",
    },
    "LblRange": {
        "t_ns": "middle between interrogation and reply",
        "transponder": "its place in the sensors file, from 0",
        "travel_time_s": "there and back, turn-around time taken off",
    },
    "SensorReport": {
        "sensor": "its name in the sensors file",
        "status": "what the filter thinks of it",
        "used": "scalar measurements that corrected the filter since the last report",
        "refused": "measurements that did not, by reason",
        "nis": "mean normalised innovation squared per degree of freedom, before the gate; null: none",
        "last_t_ns": "time of validity of its newest message; null: none yet",
    },
    "LocalisationReport": {
        "status": "how far the filter can be believed",
        "restarts": "of the filter, so far",
        "water_walk_mps_per_rts": "random walk granted to the water beyond the settings; 0: none",
        "sensors": "one report for each sensor",
    },
    "CurrentProfile": {
        "depth_m": "K depths, increasing; linear between them, constant beyond both ends",
        "north_mps": "water over ground at each depth, north",
        "east_mps": "water over ground at each depth, east",
        "sd_mps": "standard deviation of either component at each depth",
    },
    "Estimate": {
        "heading_rad": "true heading, clockwise from north seen from above; may be unwrapped",
        "depth_m": "depth below the surface; left out by surface craft",
        "velocity_down_mps": "sinking speed; 0 is assumed without it",
        "covariance": "6 x 6 of north, east, velocity north, velocity east, heading, yaw rate",
        "current": "the water's velocity over depth, as it is known",
    },
    "Solve": {
        "status": "how it ended",
        "iterations": "of the solver",
        "primal_residual": "of the scaled problem",
        "dual_residual": "of the scaled problem",
    },
    "Plan": {
        "cycle_t_ns": "start of the cycle that made it",
        "t_ns": "N + 1 knots, increasing; it takes effect at the first",
        "thrust_N": "(N + 1) x 3, commands at the knots: port, starboard, vertical; positive: ahead, ahead, down",
        "states": (
            "(N + 1) x 6, foreseen at the knots: north, east, surge and sway relative to the water, heading, yaw rate"
        ),
        "origin": "where the thrusts come from, best first",
        "solve": "the solver's account",
        "why": "of the origin, where it is not solved",
        "authority": "who commands the thrusters",
        "health": "how well the controller's inputs keep up",
        "estimate_t_ns": "t_ns of the estimate that it is built on",
        "expected_delay_ns": "from the start of the cycle to the first knot",
        "reference_m": "north, east of the target at the first knot; null before the reference begins",
        "reference_depth_m": "depth that the reference ends at; null where none is wanted",
        "progress": "of a path: the share that the target has behind it",
        "cross_track_m": "of a path: the vehicle's distance from it at the first knot, positive to starboard",
        "remaining_m": "of a path: what the target has before it",
    },
    "Command": {
        "command_id": "yours to choose: the answer has the same",
        "action": "what is asked",
        "reference_toml": "of follow: what a reference file holds, as TOML",
    },
    "Manual": {"thrust_N": "wanted: port, starboard, vertical; for a second from its arrival"},
    "Acknowledged": {
        "t_ns": "when the controller decided",
        "command_id": "of the command that this answers",
        "accepted": "whether it was done",
        "authority": "who commands the thrusters after it",
        "why": "it was refused; empty where it was accepted",
    },
    "ControllerStatus": {
        "t_ns": "when it was said",
        "estimate_age_ns": "of the newest estimate; null before the first",
        "applied_age_ns": "of the newest report of the actuators; null: plans are taken for followed",
        "cycle_median_us": "from the start of a cycle to its plan, over the last 10 s; null: no cycle",
        "cycle_p99_us": "99th percentile of the same",
        "received": "messages let in so far",
        "dropped": "messages that never came so far, by gaps in the sequences",
        "rejected": "messages refused so far, by reason",
        "clock": "by what the controller knows your time",
        "clock_error_ns": "bound of its error; null: one-way, where nobody can tell",
        "authority": "who commands the thrusters",
        "health": "how well the controller's inputs keep up",
        "error_m": "horizontal, from the newest estimate to the reference; null where nothing is followed",
        "progress": "along the reference; null where it has no end",
    },
    "CycleTiming": {
        "t_ns": "start of the cycle",
        "compute_ns": "from there to the plan's publication, vehicle time",
        "compute_wall_ns": "the same on the wall",
        "estimate_age_ns": "at the start of the cycle",
        "stage_us": "wall time by stage",
    },
    "Rejected": {
        "t_ns": "when it arrived",
        "reason": "why, in words: the field and its bound",
        "payload_base64": "what arrived, at most 3072 bytes of it",
    },
    "InboxEntry": {
        "epoch": "of the message's header",
        "sequence": "of the message's header",
        "received_t_ns": "when it arrived",
    },
    "StepRecord": {
        "step": "which of this node's steps, from 0",
        "t_ns": "time of the step",
        "cause": "grid, cycle, or the key of the message that caused it",
        "inbox": "what the step was given, in order",
    },
    "Clock": {
        "clock_epoch": "which start of the time-keeper",
        "clock_sequence": "which announcement; a repetition keeps its number",
        "host_boot_id": "of the time-keeper's host: monotonic times are comparable within one boot only",
        "at_monotonic_us": "CLOCK_MONOTONIC from which this holds",
        "vehicle_ns": "vehicle time at that instant",
        "speed_num": "speed, numerator",
        "speed_den": "speed, denominator",
        "state": "what vehicle time does from then on",
    },
    "NodeStatus": {
        "t_ns": "when it was said",
        "ready": "it can do its work",
        "waiting_for": "in words; empty where it waits for nothing",
        "steps": "so far",
        "published": "messages so far, on all keys",
        "received": "messages let in so far",
        "dropped": "messages that never came so far, by gaps in the sequences",
        "rejected": "messages refused so far",
        "step_us": "mean wall time of a step since the last status",
        "behind_us": "wall time that the message taken last had waited; the clock is slowed for who is far behind",
        "finished": "its last word",
    },
    "RunEvent": {"t_ns": "when it happened", "kind": "one word"},
}


def meaning(kind: type, field: str) -> str:
    """In words; empty where nobody has said it."""
    return OF.get(kind.__name__, {}).get(field) or EVERYWHERE.get(field, "")
