"""A team of real robots: events in, orders out, by the logic that simulated episodes have too."""
