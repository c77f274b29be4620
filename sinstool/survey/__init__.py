"""What a log holds, what is odd about it, and what will be done with it, and why."""
