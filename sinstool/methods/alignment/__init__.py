"""Alignment: the attitude of a vehicle at rest and in flight."""
