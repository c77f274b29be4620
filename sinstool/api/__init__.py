"""The Python API: the functions of the commands, without files if none are needed.

:mod:`sinstool` gives the names of this room; import them from there.
"""
