"""One evaluation: its plan, one episode in a worker, and the running tally."""
