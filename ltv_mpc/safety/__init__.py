"""What stands between a plan and the actuators, whatever the controller does."""
