"""From a log to a result: one folder for each command."""
