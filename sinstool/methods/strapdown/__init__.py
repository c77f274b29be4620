"""Rotation vectors and velocity increments into attitude, velocity, position."""
