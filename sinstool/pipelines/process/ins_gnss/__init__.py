"""A log through the INS/GNSS filter: timing, start, run, and the time before the start."""
