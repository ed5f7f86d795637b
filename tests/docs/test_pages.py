"""The documentation builds without a warning, every link leads somewhere, every public name has a page.

Slow, because the tutorials are executed: ``python -m pytest -m slow tests/docs``.
"""

from html.parser import HTMLParser
from urllib.parse import unquote, urlsplit

import pytest
from support.documentation import ROOT

import fuzzyarm

pytestmark = pytest.mark.slow


class Links(HTMLParser):
    """Links, images, scripts and styles of a page, and the anchors that it has."""

    def __init__(self, text):
        super().__init__()
        self.targets, self.anchors = [], set()
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        attributes = dict(attrs)
        self.anchors |= {attributes[name] for name in ("id", "name") if attributes.get(name)}
        self.targets += [(tag, attributes[name]) for name in ("href", "src") if attributes.get(name)]


def test_every_internal_link_leads_somewhere_and_nothing_is_fetched(site):
    pages = {path: Links(path.read_text(encoding="utf-8")) for path in site.rglob("*.html")}
    assert len(pages) > 40
    for page, links in pages.items():
        for tag, target in links.targets:
            parts = urlsplit(target)
            assert tag not in ("script", "link", "img", "iframe") or parts.scheme not in ("http", "https"), target
            if parts.scheme or target.startswith("data:"):
                continue
            other = (page.parent / unquote(parts.path)).resolve() if parts.path else page
            assert other.exists(), f"{page.relative_to(site)} links to {target}"
            if parts.fragment and other.suffix == ".html":
                assert unquote(parts.fragment) in pages[other].anchors | {""}, f"{page.relative_to(site)}: {target}"


def test_every_documented_name_has_an_entry(site):
    pages = "\n".join(path.read_text(encoding="utf-8") for path in (site / "api").glob("*.html"))
    anchors = {name.removesuffix("-class").rsplit("-", 1)[-1] for name in Links(pages).anchors if "api-" in name}
    names = {name for name in fuzzyarm.__all__ if not name.startswith("__")}
    environments = {"FuzzyArmEnv", "FuzzyArmVectorEnv", "FuzzyArmLearnEnv", "FuzzyArmLearnVectorEnv", "TorchFuzzyArm"}
    assert {name.lower().rsplit("_", 1)[-1] for name in names | environments} <= anchors


def test_figures_are_shown_somewhere():
    pages = "\n".join(path.read_text(encoding="utf-8") for path in (ROOT / "docs").rglob("*.md"))
    for figure in (ROOT / "docs" / "figures").iterdir():
        assert figure.name in pages and figure.stat().st_size < 2 * 2**20, figure.name
