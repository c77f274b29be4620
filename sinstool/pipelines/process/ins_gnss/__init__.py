"""A log through the INS/GNSS filter: timing, start, run, and what lies before the start."""
