"""What a run's episodes say: the checked table, its statistics, and the published figures beside them."""
