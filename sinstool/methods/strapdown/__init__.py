"""Attitude, velocity and position from rotation vectors and velocity increments."""
