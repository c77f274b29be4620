"""Shared basics: streams, time, Earth, rotations, units, findings, errors, whole files."""
