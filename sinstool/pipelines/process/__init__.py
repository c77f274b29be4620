"""Kinds of runs: attitude alone, inertial navigation, and with GNSS; one file each."""
