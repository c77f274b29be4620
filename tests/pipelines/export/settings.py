"""Options of an export, by their names alone."""

from sinstool.config import ProcessConfig


def configured(**options):
    tables = {"export": {}, "input": {}, "output": {}}
    for name, value in options.items():
        table = {"start": "input", "end": "input", "overwrite": "output"}.get(name, "export")
        tables[table][name] = value
    return ProcessConfig.model_validate(tables)
