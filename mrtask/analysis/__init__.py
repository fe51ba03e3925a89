"""From episodes to answers: statistics, the paper's table, figures, drawn trajectories and the report."""
