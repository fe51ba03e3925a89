"""One evaluation: its plan, a pilot, its episodes on all workers and in one worker, and the running tally."""
