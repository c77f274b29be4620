"""Alignment of a log: the command, and the first attitude of other runs."""
