"""Pages: templates of the package filled in, self-contained, allowed to run nothing but their own script."""

from __future__ import annotations

import base64
import hashlib
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING, Any

from jinja2 import Environment, FunctionLoader, StrictUndefined
from markupsafe import Markup

from inspect_pipeline.atomic import appearing
from inspect_pipeline.errors import OutputError, count_of
from inspect_pipeline.inspection.rules import PRIORITIES
from inspect_pipeline.report import words
from inspect_pipeline.report.charts import STATE_NAMES
from inspect_pipeline.resources import app_version

if TYPE_CHECKING:
    from pathlib import Path

_CSP = "default-src 'none'; img-src data:; base-uri 'none'; form-action 'none'"
_SERVED_CSP = (
    "default-src 'none'; img-src 'self' data:; connect-src 'self'; base-uri 'none'; form-action 'self'"
)


@dataclass(frozen=True, slots=True)
class Assets:
    """Style sheet and script of a page, and the policy that allows these and nothing else."""

    style: Markup
    script: Markup
    policy: str


@dataclass(frozen=True, slots=True)
class Serving:
    """How a served page reaches its server: the path of the server, and whether all flights have a page."""

    base: str
    has_store_page: bool


def load_assets(*scripts: str, serving: Serving | None = None) -> Assets:
    """Read the style sheet and scripts of the package. Both are allowed by their hashes.

    The page of a server may also load pictures from it, and send forms to it.
    """
    style, script = _read("page.css"), "\n".join(_read(name) for name in scripts)
    own = _SERVED_CSP if serving else _CSP
    policy = f"{own}; style-src '{_csp_hash(style)}'; script-src '{_csp_hash(script)}'"
    return Assets(Markup(style), Markup(script), policy)  # noqa: S704 - files of this package


def render(template: str, **values: Any) -> str:
    """Return a page of a template of the package; `page.js` is its script."""
    values = {"assets": load_assets("page.js"), "version": app_version(), "serving": None} | values
    return _environment().get_template(template).render(values)


def write_page(path: Path, page: str) -> None:
    """Write a page, whole or not at all. Raises OutputError."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with appearing(path) as part:
            part.write_text(page, encoding="utf-8", errors="replace")
    except OSError as error:
        raise OutputError(path, f"cannot be written ({error.strerror})", "name another file") from error


@cache  # templates are compiled once
def _environment() -> Environment:
    environment = Environment(
        loader=FunctionLoader(_read),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=words.clean,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    filters = ("kind_name", "percent", "metres", "measured_m", "duration", "clock", "date", "quantity")
    environment.filters |= {name: getattr(words, name) for name in filters}
    environment.filters["count_of"] = count_of
    environment.globals |= {"PRIORITIES": PRIORITIES, "STATE_NAMES": STATE_NAMES}
    return environment


def _read(name: str) -> str:
    return files("inspect_pipeline.report").joinpath("templates", name).read_text(encoding="utf-8")


def _csp_hash(text: str) -> str:
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
