"""From a result to a file of another program."""
