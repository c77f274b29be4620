"""Contents of a log, and the plan of `process` for it."""
