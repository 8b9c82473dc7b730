"""The command line as Markdown: ``python -m service.reference.commands > docs/cli.md``."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Iterable, Iterator, Sequence

from neuralmusic import cli
from neuralmusic.cli.commands import OF_THE_SERVICE, Command, installed_commands

INTRODUCTION = """\
# The command `neuralmusic`

Generated from the program by `make contracts`. The package `neuralmusic` (`pip install ./client`)
brings `neuralmusic stream` and `neuralmusic arrays`; the other commands come with the service
(`pip install ./client .`). `neuralmusic COMMAND --help` shows the same text.
"""
DEFAULT = re.compile(r" \(default:? (?P<value>[^)]*)\)")
"""What a help text says of a default that argparse does not know"""
VARIABLE = re.compile(r"; (?P<name>NEURALMUSIC_[A-Z_]+)$")
Group = tuple[str, list[argparse.Action]]


def document() -> str:
    """The page with every installed command."""
    commands = installed_commands()
    lines = [INTRODUCTION, "| command | what it does | package |", "|---|---|---|"]
    for name, command in commands.items():
        package = "neuralmusic-service" if name in OF_THE_SERVICE else "neuralmusic"
        lines.append(
            f"| [`{name}`](#neuralmusic-{name}) | {sentence(command.SUMMARY)} | `{package}` |"
        )
    lines += ["", exit_codes(), ""]
    for name, command in commands.items():
        lines += command_section(name, command)
    return "\n".join(lines)


def sentence(text: str) -> str:
    """A summary as a sentence."""
    return f"{text[:1].upper()}{text[1:].rstrip('.')}."


def exit_codes() -> str:
    """What the command's module says of its exit codes."""
    _, _, said = (cli.__doc__ or "").partition("Exit codes: ")
    return "Exit codes: " + " ".join(said.replace("``", "`").split())


def command_section(name: str, command: Command) -> Iterator[str]:
    """One command's options, and those of its actions."""
    parser = argparse.ArgumentParser(prog=f"neuralmusic {name}", description=command.SUMMARY)
    command.configure(parser)
    yield from parser_section(parser, "##")


def parser_section(parser: argparse.ArgumentParser, heading: str) -> Iterator[str]:
    """A parser's usage and tables; its subparsers follow."""
    yield from (f"{heading} `{parser.prog}`", "", sentence(parser.description or ""), "")
    groups = [group for group in visible_groups(parser) if group[1]]
    actions = [action for _, group in groups for action in group]
    yield from ("```", usage(parser.prog, actions), "```", "")
    for title, group in groups:
        yield from table(title, group)
    for action in actions:
        if isinstance(action, argparse._SubParsersAction):
            for child in action.choices.values():
                yield from parser_section(child, f"{heading}#")


def visible_groups(parser: argparse.ArgumentParser) -> Iterator[Group]:
    """Titles and actions of a parser, without ``--help`` and what is hidden."""
    for group in parser._action_groups:
        yield (
            group.title or "",
            [
                action
                for action in group._group_actions
                if action.help != argparse.SUPPRESS and not isinstance(action, argparse._HelpAction)
            ],
        )


def usage(program: str, actions: Iterable[argparse.Action]) -> str:
    """One line with what is required; argparse's own differs from one Python to the next."""
    words, operands, optional = [program], [], False
    for action in actions:
        shown = shown_name(action, action.option_strings[-1:])
        if not action.option_strings:
            operands.append(f"[{shown}]" if action.nargs in ("?", "*") else shown)
        elif action.required:
            words.append(shown)
        else:
            optional = True
    return " ".join([*words, *(["[options]"] if optional else []), *operands])


def shown_name(action: argparse.Action, names: Sequence[str]) -> str:
    """An option by these names, with what it takes, or an operand."""
    if isinstance(action, argparse._SubParsersAction):
        return str(action.metavar or "ACTION")
    value = action.metavar or (
        action.dest if not action.option_strings else action.dest.rpartition("_")[2].upper()
    )
    if action.choices is not None:
        value = "|".join(map(str, action.choices))
    if not action.option_strings:
        return f"{value}..." if action.nargs in ("+", "*") else str(value)
    return ", ".join(names) if action.nargs == 0 else f"{', '.join(names)} {value}"


def table(title: str, actions: Iterable[argparse.Action]) -> Iterator[str]:
    """The actions of one group."""
    if title not in ("options", "positional arguments"):
        yield from (f"**{title[:1].upper()}{title[1:]}**", "")
    kind = "operand" if title == "positional arguments" else "option"
    yield from (f"| {kind} | meaning |", "|---|---|")
    for action in actions:
        if isinstance(action, argparse._SubParsersAction):
            for child in action._choices_actions:
                yield f"| `{child.dest}` | {sentence(child.help or '')} |"
        else:
            shown = cell(shown_name(action, action.option_strings))
            yield f"| `{shown}` | {cell(meaning(action))} |"
    yield ""


def meaning(action: argparse.Action) -> str:
    """The help text as a sentence, with default, variable and whether it is required."""
    text = " ".join((action.help or "").replace("%%", "%").replace("*", "\\*").split())
    default, variable = DEFAULT.search(text), VARIABLE.search(text)
    said = [sentence(VARIABLE.sub("", DEFAULT.sub("", text)))]
    value = default["value"] if default else action.default
    if action.required and action.option_strings:
        said.append("Required.")
    if value not in (None, False, argparse.SUPPRESS):
        value = " ".join(map(str, value)) if isinstance(value, tuple) else value
        said.append(f"Default: `{value}`.")
    if variable:
        said.append(f"Variable: `{variable['name']}`.")
    return " ".join(said)


def cell(text: str) -> str:
    """Text within a Markdown table."""
    return text.replace("|", "\\|")


if __name__ == "__main__":
    sys.stdout.write(document())
