"""Who goes where next: the planning problem, the planners and their compiled search."""
