"""Where the vehicle of a log points: the command, and the first attitude of other runs."""
