"""Vehicle that knows nothing of this project, and the scenarios in which the controller drives it."""
