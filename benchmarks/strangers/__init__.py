"""A fleet of strangers: hulls of another structure than the controller's model, flown through its public interface."""
