"""The controller: one cycle from estimate to plan."""
