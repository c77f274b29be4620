"""`sinstool completion`: the script that lets a shell complete commands and options."""

from __future__ import annotations

import click

from sinstool.cli.console import Choice
from sinstool.cli.help import Command

VARIABLE = "_SINSTOOL_COMPLETE"


@click.command("completion", cls=Command)
@click.argument("shell", type=Choice(["bash", "zsh", "fish"]))
def command(shell: str) -> None:
    """Print the completion script of SHELL.

    \b
    bash: add to ~/.bashrc   eval "$(sinstool completion bash)"
    zsh:  add to ~/.zshrc    eval "$(sinstool completion zsh)"
    fish: run once           sinstool completion fish > ~/.config/fish/completions/sinstool.fish
    """
    from click.shell_completion import get_completion_class

    from sinstool.cli.main import cli

    kind = get_completion_class(shell)
    assert kind is not None
    click.echo(kind(cli, {}, "sinstool", VARIABLE).source())
