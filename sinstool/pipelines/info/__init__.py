"""Contents of a log, and what the other commands would do with it."""
