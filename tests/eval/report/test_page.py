"""The page as text: complete, escaped, with the numbers of the evaluation and a sentence on who won."""

import base64
import dataclasses
import hashlib
import json
import re
from html import escape
from html.parser import HTMLParser

import numpy as np
import pytest
from support.altered_evaluations import NASTY, wild, with_runs

from fuzzyarm.eval.evaluation.ranking import rank_policies
from fuzzyarm.eval.evaluation.result_table import table_rows, winners
from fuzzyarm.eval.evaluation.results_file import read_evaluation
from fuzzyarm.eval.report.page import _headline, _render_page
from fuzzyarm.eval.report.payload import replay_data
from fuzzyarm.eval.report.summary import metrics_table
from fuzzyarm.proof.certificate import NOT_COVERED


class Elements(HTMLParser):
    """Every start tag with its attributes, and the text of scripts and styles."""

    def __init__(self, text):
        super().__init__()
        self.found, self.raw = [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.found.append((tag, dict(attrs)))

    def handle_data(self, data):
        if self.found and self.found[-1][0] in ("script", "style") and data.strip():
            self.raw.append((self.found[-1], data))


def numbers(text):
    return np.frombuffer(base64.b64decode(text), "<f4")


@pytest.fixture(scope="module")
def text(folder):
    return (folder / "report.html").read_text()


def test_it_is_one_file_that_names_no_other(text):
    for tag, attributes in Elements(text).found:
        assert "src" not in attributes
        assert attributes.get("href") in (None, "data:,")
        assert tag not in ("iframe", "object", "embed", "base", "form")
    assert not re.search(r"https?://|@import|url\(", text)


def test_the_policy_admits_this_script_and_style_only(text):
    elements = Elements(text)
    policy = next(a["content"] for _, a in elements.found if a.get("http-equiv") == "Content-Security-Policy")
    assert policy.startswith("default-src 'none';") and "unsafe" not in policy
    for (tag, attributes), content in elements.raw:
        digest = base64.b64encode(hashlib.sha256(content.encode()).digest()).decode()
        assert attributes.get("type") == "application/json" or f"{tag}-src 'sha256-{digest}'" in policy


def test_a_nasty_name_stays_text(nasty_folder):
    text = (nasty_folder / "report.html").read_text()
    elements = Elements(text)
    assert not [tag for tag, _ in elements.found if tag == "img"]
    assert not [name for _, attributes in elements.found for name in attributes if name.startswith("on")]
    assert [tag for tag, _ in elements.found].count("script") == 2
    data = next(content for (_, attributes), content in elements.raw if "type" in attributes)
    assert "<" not in data and json.loads(data)["policies"][1] == NASTY
    assert "</script " in json.loads(data)["cases"][0]["runs"][1]["ended"]["reason"]
    assert "ended early in 1 of 1" in text and "× ended early" in text


def test_the_embedded_signals_are_those_of_the_rollouts(folder):
    stored = read_evaluation(folder)
    data = replay_data(stored)
    assert data["stride"] == 1
    runs = iter(stored.rollouts)
    for case in data["cases"]:
        for embedded in case["runs"]:
            run = next(runs)
            deviation = numbers(embedded["deviation"]).reshape(-1, 2)
            np.testing.assert_allclose(np.hypot(*deviation.T), run.tip_error, rtol=1e-6, atol=1e-12)
            link = numbers(embedded["link"]).reshape(-1, 2).astype(float)
            np.testing.assert_allclose(numbers(embedded["torque"]).reshape(-1, 2), run.torque, rtol=1e-6)
            motors = link + numbers(embedded["bending"]).reshape(-1, 2)
            np.testing.assert_allclose(motors, run.q_motor, rtol=1e-6, atol=1e-9)
            np.testing.assert_allclose(numbers(case["time"]), run.time, rtol=1e-6)
            if case["force"]:
                np.testing.assert_allclose(numbers(case["force"]).reshape(-1, 2), run.external_force, rtol=1e-6)


def test_many_policies_are_thinned_to_fit_and_the_page_says_so(evaluation):
    run = evaluation.rollouts[0]
    many = [dataclasses.replace(run, policy=f"policy-{k}") for k in range(60)]
    many += [wild(run, "early", 703)]
    stored = with_runs(evaluation, many)
    text = _render_page(stored)
    assert len(text.encode()) < 3_000_000
    stride = replay_data(stored)["stride"]
    assert stride > 1 and f"one sample in {stride} and the last of each episode" in text
    last = replay_data(stored)["cases"][0]["runs"][-1]
    np.testing.assert_allclose(numbers(last["torque"])[-2:], many[-1].torque[-1], rtol=1e-6)


def test_the_table_has_the_cells_of_the_terminal(evaluation, text):
    for _, policy, cells in table_rows(evaluation.rows):
        row = re.search(rf'<th scope="row"><span class="swatch"></span>{policy}</th>(.*?)</tr>', text).group(1)
        assert row.count("<td") == len(cells)
    cells = re.findall(r"<td[^>]*>(.*?)</td>", metrics_table(evaluation.rows, evaluation.config.titles))
    expected = [escape(re.sub(r"\.(?!\d)", "", cell)) for _, _, row in table_rows(evaluation.rows) for cell in row]
    assert cells == expected


def test_certificates_are_there_in_words(evaluation, text):
    assert "and not for the sampled elastic arm" in text and NOT_COVERED in text
    assert escape(evaluation.certificates["fuzzy-4"]) in text
    assert "Nothing is proven of the rigid arm: computed-torque." in text


def test_the_sentence_says_who_leads_the_leaderboard_and_who_won_each_case(evaluation, folder, text):
    first = rank_policies([folder]).standings[0]
    lines = winners(evaluation.rows, evaluation.config.titles)
    said = "; ".join([f"Best score: {first.policy}, {first.cells[0]} mm", *lines])
    assert f'id="headline">{escape(said)}.</p>' in text
    alone = with_runs(evaluation, evaluation.rollouts[:1])
    assert _headline(alone) == f"{winners(alone.rows, alone.config.titles)[0]}."
