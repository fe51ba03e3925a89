"""Maps: occupancy grids of homes, with the distances from every cell to every container."""
