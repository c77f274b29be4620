"""Rotation vectors from gyro samples: one file for each family of coning algorithms.

Start at :mod:`~sinstool.methods.coning.registry` for the names,
:mod:`~sinstool.methods.coning.stage` to run one over a log,
:mod:`~sinstool.methods.coning.response` for its error in classical coning. This package imports
none of them itself, as most need the compiler.
"""
