"""Coning algorithms: their names, and how a program adds its own."""

from __future__ import annotations

from sinstool.methods.coning.algorithm import ConingAlgorithm, MultiSampleAlgorithm
from sinstool.methods.coning.registry import algorithm, register
from sinstool.methods.coning.registry import all_names as names

__all__ = ["ConingAlgorithm", "MultiSampleAlgorithm", "algorithm", "names", "register"]
