"""The vehicle: parameters, equations of motion, their exact flow, and its thrusters."""
