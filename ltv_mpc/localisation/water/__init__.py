"""Model of the water column: its prior over depth, and the grid of cells that the filter estimates."""
