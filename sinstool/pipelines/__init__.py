"""From a log to an answer: one folder for each command."""

from sinstool.core.compiled import load_quickly

load_quickly()
