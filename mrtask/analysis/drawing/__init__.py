"""Homes, tasks and episodes as drawings: floor plans, trajectories and replays."""
