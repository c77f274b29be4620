"""The Python API: what the commands do, from a program, without files where none are wanted.

:mod:`sinstool` gives the names of this room; import them from there.
"""
