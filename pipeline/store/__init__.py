"""Everything that is kept: folders, rows, typed records, home files, caches, and what identifies them."""
