"""Gyro samples into rotation vectors: one file for each family of coning algorithms.

Start at :mod:`~sinstool.coning.registry` for the names, :mod:`~sinstool.coning.stage` to run
one over a log, :mod:`~sinstool.coning.response` for what one does in coning. This package
imports none of them itself, as most need the compiler.
"""
