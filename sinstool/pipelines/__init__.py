"""From a log to a result: one folder for each command."""

from sinstool.core.compiled import set_up_cache

set_up_cache()
