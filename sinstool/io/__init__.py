"""The door: logs in, logs out. Axes, units and quaternions are turned here and nowhere else."""
