"""Vehicle model: parameters, equations of motion, their exact flow, thrusters, identification."""
