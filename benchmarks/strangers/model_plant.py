"""The controller's own equations with the parameters of a vehicle file, as a hull.

M nu' + C(nu) nu = f with a diagonal M of surge, sway and yaw is the model of ``vehicle/template.toml``. The thrust
itself follows the command with the lag.
"""

from __future__ import annotations

import numpy as np

from benchmarks.strangers.rigid_body import Hull
from ltv_mpc.vehicle.parameters import Vehicle


def hull(vehicle: Vehicle) -> Hull:
    """Return the hull of a vehicle file. Heave, roll and pitch are not excited."""
    surge, sway, yaw, port = vehicle.surge, vehicle.sway, vehicle.yaw, vehicle.thrusters[0]
    return Hull(
        name=vehicle.name,
        M=np.diag([surge.mass_kg, sway.mass_kg, sway.mass_kg, 1.0, 1.0, yaw.inertia_kgm2]),
        D=np.diag([surge.linear_damping_kgps, sway.linear_damping_kgps, 1.0, 1.0, 1.0, yaw.linear_damping_Nms]),
        quadratic=np.array(
            [
                surge.quadratic_damping_kgpm,
                sway.quadratic_damping_kgpm,
                0.0,
                0.0,
                0.0,
                yaw.quadratic_damping_kgm2,
            ]
        ),
        centre_of_gravity=(0.0, 0.0, 0.0),
        max_N=port.max_N,
        min_N=port.min_N,
        arms_m=(port.arm_m, vehicle.thrusters[1].arm_m),
        lag_s=port.lag_s,
        lag_of_revolutions=False,
    )
