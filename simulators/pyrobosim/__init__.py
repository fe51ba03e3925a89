"""pyrobosim as the world of a live team: homes as its worlds, its robots on the team's routes, in stepped time."""
