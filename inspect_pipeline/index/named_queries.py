"""Queries with names: the files of schemas/queries, each with a comment that says what it answers.

$name in the SQL stands for a value that the caller gives.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from importlib.resources import files
from typing import TYPE_CHECKING

from inspect_pipeline.errors import QueryError, QueryValuesError

if TYPE_CHECKING:
    from collections.abc import Mapping

_PARAMETER = re.compile(r"\$([a-z_]+)")


@dataclass(frozen=True, slots=True)
class NamedQuery:
    """The name and SQL of a query, what it answers, and the names of the values it needs."""

    name: str
    sql: str

    @property
    def purpose(self) -> str:
        """Its first comment."""
        comments = [line[2:].strip() for line in self.sql.splitlines() if line.startswith("--")]
        return " ".join(comments)

    @property
    def parameters(self) -> tuple[str, ...]:
        """The names of its values, in the order they appear."""
        return tuple(dict.fromkeys(_PARAMETER.findall(self._statement())))

    def with_values(self, values: Mapping[str, str]) -> str:
        """Return the statement with its values as text literals. Raises QueryValuesError for other values."""
        if set(values) != set(self.parameters):
            raise QueryValuesError(self.name, self.parameters)
        literals = {name: "'" + value.replace("'", "''") + "'" for name, value in values.items()}
        return _PARAMETER.sub(lambda match: literals[match[1]], self._statement())

    def _statement(self) -> str:
        return "\n".join(line for line in self.sql.splitlines() if not line.startswith("--"))


def named_queries() -> dict[str, NamedQuery]:
    """Return all named queries, by name."""
    folder = files("inspect_pipeline.schemas").joinpath("queries")
    found = [path for path in folder.iterdir() if path.name.endswith(".sql")]
    queries = [NamedQuery(path.name.removesuffix(".sql"), path.read_text(encoding="utf-8")) for path in found]
    return {query.name: query for query in sorted(queries, key=lambda query: query.name)}


def find_query(name: str) -> NamedQuery:
    """Return the query of a name; raises QueryError."""
    queries = named_queries()
    if name not in queries:
        raise QueryError(f"no query is named {name!r}; there are {', '.join(queries)}")
    return queries[name]
