"""Pages of reports, read by an HTML parser."""

from __future__ import annotations

import base64
import hashlib
from html.parser import HTMLParser

HOSTILE = "<script>alert(1)</script>\x1b[31m\"'&\u202e"
_VOID = {"meta", "br", "img", "link", "input", "hr"}


class Page(HTMLParser):
    """What a page holds; tags that do not match are refused."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.ids: list[str] = []
        self.links: list[str] = []
        self.scripts: list[str] = []
        self.styles: list[str] = []
        self.attributes: set[str] = set()
        self.policy = ""
        self.text = ""
        self._open: list[str] = []
        self.feed(text)
        self.close()
        assert self._open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = dict(attrs)
        self.attributes |= set(values)
        self.ids += [values["id"]] if values.get("id") else []
        self.links += [values[name] for name in ("href", "src") if values.get(name)]
        if values.get("http-equiv") == "Content-Security-Policy":
            self.policy = values["content"] or ""
        if tag not in _VOID:
            self._open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        self.handle_endtag(tag)

    def handle_endtag(self, tag: str) -> None:
        if tag not in _VOID:
            assert self._open.pop() == tag

    def handle_data(self, data: str) -> None:
        inside = self._open[-1] if self._open else ""
        if inside in ("script", "style"):
            (self.scripts if inside == "script" else self.styles).append(data)
        else:
            self.text += data


def check(page: Page, elsewhere: tuple[str, ...] = ()) -> None:
    """Links lead to elements of the page, ids are unique, nothing is loaded, only hashed code runs.

    elsewhere: beginnings of links that may lead to other pages.
    """
    assert len(page.ids) == len(set(page.ids))
    for link in page.links:
        assert link[1:] in page.ids or link.startswith(("data:", *elsewhere)), link
    assert not [name for name in page.attributes if name.startswith("on") or name == "style"]
    for kind, (code,) in {"script-src": page.scripts, "style-src": page.styles}.items():
        digest = base64.b64encode(hashlib.sha256(code.encode()).digest()).decode()
        assert f"{kind} 'sha256-{digest}'" in page.policy
    assert page.policy.startswith("default-src 'none'")
    assert "unsafe" not in page.policy
