"""Ground station by MAVSDK, which nobody here wrote. Run as a process of its own: ``python -m ... PORT``.

It connects, uploads a mission, arms, sets the mode MANUAL, and reads telemetry until it is ended; lines of JSON.
"""

from __future__ import annotations

import asyncio
import json
import sys
from typing import Any

PLACES = ((50.2, -5.1), (50.20004, -5.1), (50.20004, -5.09996))


def say(**fields: Any) -> None:
    sys.stdout.write(json.dumps(fields) + "\n")
    sys.stdout.flush()


async def main(port: int) -> None:
    """Run the ground station."""
    from mavsdk.asyncio.mavsdk import Configuration, Mavsdk
    from mavsdk.asyncio.plugins.action.action import ActionAsync
    from mavsdk.asyncio.plugins.mission_raw.mission_raw import MissionRawAsync
    from mavsdk.asyncio.plugins.telemetry.telemetry import TelemetryAsync
    from mavsdk.component_type import ComponentType
    from mavsdk.plugins.mission_raw.mission_raw import MissionItem

    configuration = Configuration.create_with_component_type(ComponentType.GROUND_STATION)
    async with Mavsdk(configuration) as mavsdk:
        await mavsdk.add_any_connection(f"udpin://127.0.0.1:{port}")
        system = await mavsdk.first_autopilot(timeout_s=60.0)
        assert system is not None
        say(system=await system.get_system_id())
        items = [
            MissionItem(
                seq=at,
                frame=6,
                command=16,
                current=int(at == 0),
                autocontinue=1,
                x=round(lat * 1e7),
                y=round(lon * 1e7),
            )
            for at, (lat, lon) in enumerate(PLACES)
        ]
        await MissionRawAsync(system).upload_mission(items)
        say(uploaded=len(items))
        await ActionAsync(system).arm()
        say(armed=True)
        telemetry = TelemetryAsync(system)
        async for position in telemetry.subscribe_position():
            say(latitude_deg=position.latitude_deg, longitude_deg=position.longitude_deg)


if __name__ == "__main__":
    asyncio.run(main(int(sys.argv[1])))
