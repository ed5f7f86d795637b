"""Each page of the documentation in Chromium: no console error, no request to a network, no overflow."""

import importlib
import json
import os
import re

import pytest
from support.browser import chromium, executable
from support.documentation import ROOT

pytestmark = pytest.mark.slow
if executable() is None and not os.environ.get("CI_BROWSER"):
    pytest.skip("Chromium is not installed", allow_module_level=True)

READERS = {"desk": (1400, 900, "light"), "phone": (390, 844, "dark")}


@pytest.fixture(scope="module")
def tab():
    with chromium() as opened:
        yield opened


def test_every_page_opens(site, tab):
    for page in sorted(site.rglob("*.html")):
        name = page.relative_to(site)
        tab.open(page)
        for reader, (width, height, scheme) in READERS.items():
            tab.size(width, height)
            tab.prefer(scheme)
            assert tab.run("document.documentElement.scrollWidth") <= width, f"{name} is wider than a {reader}"
            assert tab.run("[...document.images].every(image => image.complete && image.naturalWidth > 0)"), name
            assert not tab.problems, (name, reader, tab.problems)
        assert not [url for url in tab.requests if not url.startswith(("file:", "data:"))], name


def test_what_a_reader_types_leads_to_its_page_first_without_a_server(site, tab, monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "docs/_extensions")
    for page, words in importlib.import_module("search_words").WORDS.items():
        for word in words.split(", "):
            tab.call("Page.navigate", url=f"{(site / 'search.html').as_uri()}?q={word.replace(' ', '+')}")
            first = "document.querySelector('#search-results li a')"
            tab.wait_for(f"location.search === '?q={word.replace(' ', '+')}' && {first} !== null")
            assert tab.run(f"{first}.getAttribute('href')").startswith(f"{page}.html"), word


def test_axe_finds_nothing(site, tab):
    for page in sorted(site.rglob("*.html")):
        tab.open(page, width=390)
        assert tab.barriers() == [], page.relative_to(site)


def test_commands_print_whole_lines(site):
    page = (site / "tutorials/own-controller.html").read_text(encoding="utf-8")
    assert re.search(r"nominal +machining force +5 kg payload", page)


@pytest.mark.parametrize(("payload", "share", "case"), [(0, 1, "machining"), (5, 0, "payload"), (0, 0, "nominal")])
def test_the_arm_in_the_browser_errs_as_the_package_does(payload, share, case, site, tab):
    tab.open(site / "try.html")
    tab.wait_for("document.body.dataset.arm === 'ready'")
    for name, value in (("payload", payload), ("force", share)):
        slider = f"document.querySelector('#arm-{name}')"
        tab.run(f"{slider}.value = {value}; {slider}.dispatchEvent(new Event('input'))")
    stored = json.loads((ROOT / "benchmarks/results/evaluate.json").read_text(encoding="utf-8"))["results"]
    for number, policy in enumerate(("fuzzy-4-tip", "elastic-observer")):
        (row,) = [row for row in stored if (row["policy"], row["case"]) == (policy, case)]
        for key, shown in (("rms", "tip_error_rms_mm"), ("largest", "tip_error_max_mm")):
            text = tab.run(f"document.querySelector('#arm-{key}-{number}').textContent")
            assert text == "< 0.001" if row[shown] < 1e-3 else float(text) == float(f"{row[shown]:.3g}")
    assert (site / "_static/arm.js").stat().st_size + (site / "_static/try.js").stat().st_size < 200_000
