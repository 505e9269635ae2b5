"""Edge to ArduPilot (Rover boats with skid steering, Sub) over MAVLink. It needs the extra ``mavlink``."""
