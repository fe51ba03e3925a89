"""The results of a run's episodes: the checked table, its statistics, and the published figures beside them."""
