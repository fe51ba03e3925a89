"""Episodes: trials, the simulated team, and traces."""
