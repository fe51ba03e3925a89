"""One evaluation: its plan, a pilot of it, its episodes over all workers and in one, and the running tally."""
