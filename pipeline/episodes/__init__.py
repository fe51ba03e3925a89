"""One evaluation: its plan, its episodes on all workers and in one worker, and the running tally."""
