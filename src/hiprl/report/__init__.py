"""Numbers and pictures of runs, read from the store."""
