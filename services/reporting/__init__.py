"""Reports, figures, plots and texts about a run."""
