"""From a log to an answer: one folder for each command."""
