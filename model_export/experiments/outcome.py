"""Outcomes of experiments: tables and figures, as JSON and as Markdown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

Entry = str | float | None
Rows = tuple[tuple[Entry, ...], ...]


@dataclass(frozen=True, slots=True)
class Table:
    """Rows of names and numbers."""

    columns: tuple[str, ...]
    rows: Rows
    """Names and measured numbers; None where there is no number"""
    digits: int = 2

    def markdown(self) -> str:
        """The table as Markdown."""
        lines = ["| " + " | ".join(self.columns) + " |", "|---" * len(self.columns) + "|"]
        lines += ["| " + " | ".join(map(self._shown, row)) + " |" for row in self.rows]
        return "\n".join(lines)

    def _shown(self, cell: Entry) -> str:
        if cell is None:
            return "–"
        return cell if isinstance(cell, str) else f"{cell:,.{self.digits}f}"


@dataclass(frozen=True, slots=True)
class Outcome:
    """One experiment's outcome."""

    text: str
    """The experiment, and its differences from the paper"""
    tables: Sequence[Table] = field(default_factory=tuple)
    figures: Sequence[tuple[str, str]] = field(default_factory=tuple)
    """Caption and file name"""

    def markdown(self) -> str:
        """Text, tables and figures."""
        parts = [self.text, *(table.markdown() for table in self.tables)]
        parts += [f"![{caption}](comparison/{name})" for caption, name in self.figures]
        return "\n\n".join(parts)

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)

    @classmethod
    def from_dict(cls, fields: dict[str, Any]) -> Outcome:
        """Restore the result of ``as_dict``, also after a round trip through JSON."""
        tables = tuple(
            Table(tuple(t["columns"]), tuple(tuple(row) for row in t["rows"]), t["digits"])
            for t in fields["tables"]
        )
        figures = tuple((caption, name) for caption, name in fields["figures"])
        return cls(fields["text"], tables, figures)
