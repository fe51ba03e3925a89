"""Where objects lie, from names alone: labelled rows, models, their training, metrics and lookup table."""
