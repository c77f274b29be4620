"""Truth trajectories with exact inertial samples, and the errors of sensors."""

from sinstool.core.compiled import load_quickly

load_quickly()
