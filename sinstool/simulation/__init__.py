"""Truth trajectories with exact inertial samples, and the errors of sensors."""
