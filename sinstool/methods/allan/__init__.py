"""Noise of inertial sensors at rest: Allan and Hadamard deviations, and the terms behind them."""
