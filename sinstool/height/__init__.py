"""Height: from air pressure, and the damping network that holds the vertical channel to it.

Start at :mod:`~sinstool.height.network` for the network and its gains,
:mod:`~sinstool.height.vertical` to run a vertical channel over a log,
:mod:`~sinstool.height.channel` to put one into a mechanisation, and
:mod:`~sinstool.height.pressure` to make heights of pressures. This package imports none of
them itself, as some need the compiler.
"""
