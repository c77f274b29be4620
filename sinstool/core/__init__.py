"""What everybody speaks: streams, time, Earth, rotations, units, findings, errors, whole files."""
