"""The public Python names as Markdown: ``python -m service.reference.names > docs/python.md``."""

from __future__ import annotations

import ast
import inspect
import re
import sys
import textwrap
from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass
from typing import Any, cast

import neuralmusic
import service
from neuralmusic.errors import DoaError
from neuralmusic.protocol.message import message_type
from neuralmusic.protocol.server_messages import SERVER_MESSAGES

INTRODUCTION = """\
# Python

Generated from signatures and docstrings by `make contracts`. The package `neuralmusic`
(`pip install ./client`, Python 3.9 and newer) is a robot's: streams and, with the extra `http`,
recordings. The package `neuralmusic-service` (`pip install ./client .`, Python 3.11 and newer)
localizes in the caller's process. [`examples/`](../examples/README.md) holds complete programs.
"""
EVENTS = """\
## Events

Reading a stream yields `StreamEvent`: `Reconnecting`, `NewSession`, or one of the server's messages
from `neuralmusic.protocol.server_messages`, whose attributes are the fields in
[protocol.md](protocol.md).

| class | message | meaning |
|---|---|---|"""
ERRORS = """\
## Errors

All errors are a `neuralmusic.errors.DoaError` with `code`, `title`, `detail` and `retryable`;
[errors.md](errors.md) lists the codes. `neuralmusic` has those that clients raise themselves:

| error | is a | meaning |
|---|---|---|"""
CLASSES = {
    "Streams": (
        "StreamClient",
        "AsyncStreamClient",
        "Reconnecting",
        "NewSession",
        "Backoff",
        "Timeouts",
    ),
    "Recordings": ("LocalizationClient", "AsyncLocalizationClient"),
}
SECTION = re.compile(r"^(?P<title>[A-Z]\w+)\n-+$", re.MULTILINE)
"""The heading of a part of a docstring in numpydoc's style"""


def document() -> str:
    """The page with every public name."""
    lines = [INTRODUCTION]
    documented: dict[Any, str] = {}
    for title, names in CLASSES.items():
        lines += [f"## {title}", "", f"`from neuralmusic import {', '.join(names)}`", ""]
        for name in names:
            lines += class_section(getattr(neuralmusic, name), documented)
    lines += [*events(), *errors(), "## In the caller's process", ""]
    lines += ["`from service import localize`", ""]
    lines += function_section(service.localize, "localize", "###")
    return "\n".join(lines).rstrip() + "\n"


def class_section(kind: type, documented: dict[Any, str]) -> Iterator[str]:
    """A class: its constructor, its properties and methods that no class before it has shown."""
    yield from (f"### `{kind.__name__}`", "", *prose(inspect.getdoc(kind) or ""))
    constructor = inspect.getattr_static(kind, "__init__")
    if constructor in documented:
        yield from (f"The arguments are those of `{documented[constructor]}`.", "")
    else:
        documented[constructor] = kind.__name__
        yield from (f"```python\n{signature(kind.__name__, kind)}\n```", "")
        if is_dataclass(kind):
            yield from attributes(kind)
            return
        yield from prose(inspect.getdoc(constructor) or "") if constructor.__doc__ else ()
    again: dict[str, list[str]] = {}
    for name, member in public_members(kind):
        if member in documented:
            again.setdefault(documented[member], []).append(f"`{name}`")
            continue
        documented[member] = kind.__name__
        if isinstance(member, property):
            value = inspect.signature(cast(Any, member.fget)).return_annotation
            yield from (f"#### `{name}: {value}`", "", *prose(inspect.getdoc(member) or ""))
        else:
            yield from function_section(member, name, "####")
    for other, names in again.items():
        yield from (f"The same as in `{other}`: {', '.join(names)}.", "")


def public_members(kind: type) -> Iterator[tuple[str, Any]]:
    """Properties and methods, its own first, then inherited ones, in the order of the source."""
    seen = set()
    for each in kind.__mro__[:-1]:
        for name, member in vars(each).items():
            shown = isinstance(member, property) or inspect.isfunction(member)
            if shown and not name.startswith("_") and name not in seen:
                seen.add(name)
                yield name, member


def function_section(function: Callable[..., Any], name: str, heading: str) -> Iterator[str]:
    """A function or method with its docstring."""
    yield from (f"{heading} `{name}`", "", f"```python\n{signature(name, function)}\n```", "")
    yield from prose(inspect.getdoc(function) or "")


def signature(name: str, function: Callable[..., Any]) -> str:
    """A signature, a parameter a line where it is long; annotations as they are written."""
    found = inspect.signature(function)
    parts, keywords = [], False
    for parameter in found.parameters.values():
        if parameter.name == "self":
            continue
        if parameter.kind is parameter.KEYWORD_ONLY and not keywords:
            parts.append("*")
            keywords = True
        default = "" if parameter.default is parameter.empty else f" = {parameter.default!r}"
        parts.append(f"{parameter.name}: {parameter.annotation}{default}")
    returned = found.return_annotation
    result = "" if returned in (found.empty, None, "None") else f" -> {returned}"
    prefix = "async " if inspect.iscoroutinefunction(function) else ""
    line = f"{prefix}{name}({', '.join(parts)}){result}"
    if len(line) <= 100:
        return line
    return f"{prefix}{name}(\n    " + ",\n    ".join(parts) + f",\n){result}"


def prose(docstring: str) -> Iterator[str]:
    """A docstring in numpydoc's style as Markdown."""
    parts = SECTION.split(docstring)
    yield from (plain(parts[0]), "")
    for title, body in zip(parts[1::2], parts[2::2], strict=True):
        yield from (f"**{title}**", "")
        yield from ([plain(body)] if title == "Notes" else entries(body))
        yield ""


def entries(body: str) -> Iterator[str]:
    """The entries of a docstring's part as a list: a name, perhaps its type, and what it means."""
    for entry in re.split(r"\n(?=\S)", body.strip()):
        head, _, meaning = entry.partition("\n")
        name, _, kind = head.partition(" : ")
        shown = f"- `{name}`" + (f" ({kind})" if kind else "")
        yield f"{shown}: {plain(textwrap.dedent(meaning))}"


def attributes(kind: type) -> Iterator[str]:
    """The fields of a dataclass with the docstrings below them."""
    tree = ast.parse(textwrap.dedent(inspect.getsource(kind))).body[0]
    assert isinstance(tree, ast.ClassDef)
    meanings: dict[str, str] = {}
    for field, said in zip(tree.body, tree.body[1:], strict=False):
        match field, said:
            case (
                ast.AnnAssign(target=ast.Name(id=name)),
                ast.Expr(value=ast.Constant(value=str(meaning))),
            ):
                meanings[name] = meaning
    shown = [field.name for field in fields(cast(Any, kind)) if field.name in meanings]
    yield from (f"- `{name}`: {plain(meanings[name])}" for name in shown)
    yield ""


def plain(text: str) -> str:
    """Text of a docstring as Markdown's, a paragraph a line."""
    paragraphs = re.split(r"\n\s*\n", text.strip())
    return "\n\n".join(" ".join(each.replace("``", "`").split()) for each in paragraphs)


def events() -> Iterator[str]:
    """What iterating a stream yields."""
    yield EVENTS
    for message in SERVER_MESSAGES:
        kind, meaning = message_type(message), plain(message.__doc__ or "")
        yield f"| `{message.__name__}` | [`{kind}`](protocol.md#{kind}) | {meaning} |"
    yield ""


def errors() -> Iterator[str]:
    """The errors that clients raise themselves."""
    yield ERRORS
    for name in neuralmusic.__all__:
        kind = getattr(neuralmusic, name)
        if isinstance(kind, type) and issubclass(kind, DoaError):
            meaning = plain(SECTION.split(inspect.getdoc(kind) or "")[0])
            yield f"| `{name}` | `{kind.__mro__[1].__name__}` | {meaning} |"
    yield ""


if __name__ == "__main__":
    sys.stdout.write(document())
