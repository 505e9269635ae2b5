"""Common control laws that fly beside the controller, and the search by which each is tuned."""
