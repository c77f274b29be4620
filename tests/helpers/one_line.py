"""Errors of commands, each of which is a single line."""


def one_line(err):
    """The one line of an error, and nothing of Python in it."""
    lines = err.strip().split("\n")
    assert len(lines) == 1, err
    assert lines[0].startswith("sinstool: ")
    assert "Traceback" not in err
    return lines[0]


def usage(err):
    line = one_line(err)
    assert line.endswith(" --help")
    return line


def last_words(err):
    """The one line of an error behind warnings."""
    return one_line("\n".join(x for x in err.split("\n") if not x.startswith("warning: ")))
