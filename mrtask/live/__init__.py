"""A team of real robots: events in, orders out, by the same logic as in simulated episodes."""
