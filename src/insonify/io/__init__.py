"""Files: maps, results, and folders that are written whole or not at all."""
