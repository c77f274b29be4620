"""Height from air pressure, and the damping network of the vertical channel.

Start at :mod:`~sinstool.methods.height.network` for the network and its gains,
:mod:`~sinstool.methods.height.vertical` to run a vertical channel over a log,
:mod:`~sinstool.methods.height.channel` to put one into a mechanisation, and
:mod:`~sinstool.methods.height.reference` to make heights of pressures. This package imports none of
them itself, as some need the compiler.
"""
