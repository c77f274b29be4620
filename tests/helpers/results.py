"""Definitions of the types that results are written in, as rosbags has them.

python -m tests.helpers.results

writes them to where the package looks for them.
"""

import json

from sinstool.io.messages.definitions import ENCODINGS, collected
from sinstool.io.writers.solution import DIAGNOSTICS_TYPE, TOPICS
from tests.helpers.paths import ROOT

PATH = ROOT / "sinstool/io/messages/results.json"


def content():
    """Schema text and hash by encoding and type."""
    names = sorted({topic.type_name for topic in TOPICS.values()} | {DIAGNOSTICS_TYPE})
    types = {one: {name: collected(name, one) for name in names} for one in ENCODINGS}
    return json.dumps(types, indent=1) + "\n"


if __name__ == "__main__":
    PATH.write_text(content())
