"""From a log to an answer: one folder for each command."""

from sinstool.core.compiled import set_up_cache

set_up_cache()
