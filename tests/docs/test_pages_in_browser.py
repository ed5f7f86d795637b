"""Each page of the documentation in Chromium: no console error, no request to a network, no overflow."""

import os

import pytest
from support.browser import chromium, executable

pytestmark = pytest.mark.slow
if executable() is None and not os.environ.get("CI_BROWSER"):
    pytest.skip("Chromium is not installed", allow_module_level=True)

SIZES = {"desk": (1400, 900), "phone": (390, 844)}


@pytest.fixture(scope="module")
def tab():
    with chromium() as opened:
        yield opened


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("size", SIZES)
def test_every_page_opens(site, tab, size, scheme):
    width, height = SIZES[size]
    for page in sorted(site.rglob("*.html")):
        name = page.relative_to(site)
        tab.open(page, width=width, height=height, scheme=scheme)
        assert not tab.problems, (name, tab.problems)
        assert not [url for url in tab.requests if not url.startswith(("file:", "data:"))], name
        assert tab.run("[...document.images].every(image => image.complete && image.naturalWidth > 0)"), name
        assert tab.run("document.documentElement.scrollWidth") <= width, f"{name} is wider than {size}"


def test_search_works_without_a_server(site, tab):
    tab.open(site / "search.html")
    tab.call("Page.navigate", url=f"{(site / 'search.html').as_uri()}?q=certificate")
    tab.wait_for("document.querySelectorAll('#search-results li').length > 0")
    assert "certificate" in tab.run("document.querySelector('#search-results').innerText").lower()
