"""Common control laws that fly beside the controller."""
