"""Kinds of runs: attitude alone, inertial navigation, and INS/GNSS; one file each."""
