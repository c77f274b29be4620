"""Vehicles that rest and that cannot slide: evidence in a log.

A filter without constraints runs first. Its smoothed velocity says when the vehicle stood, how the
IMU is mounted in it, and how well the velocity stays within the vehicle's forward axis; only what
holds there is used as a measurement of a second filter.
"""
