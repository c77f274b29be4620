"""What a log holds, and what the other commands would do with it."""
