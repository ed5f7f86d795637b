"""The documentation builds without a warning, every link leads somewhere, every public name has a page.

Slow, because the tutorials are executed: ``python -m pytest -m slow tests/docs``.
"""

import importlib
import pkgutil
from html.parser import HTMLParser
from urllib.parse import unquote, urlsplit

import pytest

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
        for name in ("href", "src"):
            if attributes.get(name):
                self.targets.append((tag, attributes[name]))


def test_every_internal_link_leads_somewhere(site):
    pages = {path: Links(path.read_text(encoding="utf-8")) for path in site.rglob("*.html")}
    assert len(pages) > 60
    for page, links in pages.items():
        for _, target in links.targets:
            parts = urlsplit(target)
            if parts.scheme or target.startswith("data:"):
                continue
            other = (page.parent / unquote(parts.path)).resolve() if parts.path else page
            assert other.exists(), f"{page.relative_to(site)} links to {target}"
            if parts.fragment and other.suffix == ".html":
                assert unquote(parts.fragment) in pages[other].anchors | {""}, f"{page.relative_to(site)}: {target}"


def test_nothing_is_fetched(site):
    for page in site.rglob("*.html"):
        for tag, target in Links(page.read_text(encoding="utf-8")).targets:
            if tag in ("script", "link", "img", "iframe") and urlsplit(target).scheme in ("http", "https"):
                raise AssertionError(f"{page.relative_to(site)} fetches {target}")


def test_every_public_name_has_a_page(site):
    for info in pkgutil.walk_packages(fuzzyarm.__path__, "fuzzyarm."):
        if info.name.endswith("__main__"):
            continue
        module = importlib.import_module(info.name)
        names = getattr(module, "__all__", ())
        if not names:
            continue
        page = site / "api" / f"{info.name}.html"
        anchors = Links(page.read_text(encoding="utf-8")).anchors
        for name in names:
            label = f"api-{info.name}.{name}".lower().replace("_", "-").replace(".", "-")
            assert anchors & {label, f"{label}-class", f"{label}-data"}, (info.name, name)
