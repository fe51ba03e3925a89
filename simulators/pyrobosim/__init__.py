"""pyrobosim as a live team's world: its worlds are homes, its robots drive the team's routes, time goes in steps."""
