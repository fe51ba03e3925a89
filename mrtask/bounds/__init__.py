"""Lower bounds on what any planner can reach in expectation under its own belief."""
