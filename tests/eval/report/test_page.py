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

from fuzzyarm.envs.scenario.cases import CASES
from fuzzyarm.eval.evaluation.ranking import Standing, rank_policies, standings_of
from fuzzyarm.eval.evaluation.result_table import table_rows
from fuzzyarm.eval.evaluation.results_file import read_evaluation
from fuzzyarm.eval.evaluation.statistics import Estimate
from fuzzyarm.eval.report.certificates import Observed
from fuzzyarm.eval.report.page import _headline, _render_page, _rule
from fuzzyarm.eval.report.payload import replay_data
from fuzzyarm.eval.report.summary import _best, metrics_table
from fuzzyarm.proof.certificate import NOT_COVERED

SEEN = {"fuzzy-4": Observed(20.5, 7e-5, "step"), "fuzzy-4-tip": "not observed: for a reason"}


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
    assert not re.search(r"https?://|@import|url\((?!#hatch\))", text)


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
    text = _render_page(stored, {})
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


def rows(values, completed=()):
    return {name: [{"m": v, "completed": name not in completed} for v in vs] for name, vs in values.items()}


@pytest.mark.parametrize(
    ("values", "early", "expected"),
    [
        ({"a": [3.0], "b": [1.0], "c": [2.0]}, (), {"b"}),
        ({"a": [3.0], "b": [-4.0]}, (), {"a"}),  # the size counts
        ({"a": [1.0], "b": [1.0], "c": [2.0], "d": [3.0]}, (), {"a", "b"}),
        ({"a": [1.0], "b": [1.0], "c": [2.0]}, (), set()),  # no distinction
        ({"a": [1.0], "b": [2.0], "c": [3.0]}, ("a",), {"b"}),  # shorter motions do not compete
        ({"a": [1.0], "b": [2.0]}, ("a",), set()),
        ({"a": [1.0, 9.0, 8.0], "b": [5.0, 6.0, 7.0]}, (), {"b"}),  # medians
    ],
)
def test_the_best_of_a_column(values, early, expected):
    texts = {name: str(vs[0]) for name, vs in values.items()}
    assert _best(rows(values, early), ("m",), texts) == expected


def test_certificates_stand_beside_what_was_observed(evaluation):
    text = _render_page(evaluation, SEEN)
    assert "not for the sampled elastic arm" in text and NOT_COVERED in text
    assert "20.5 ≥ 20<" in text and "70.0 ≤ 140<" in text
    assert "> ≥ 20<" not in text and ">≥ 20<" in text  # the bound alone where nothing was observed
    assert "fuzzy-4-tip: not observed: for a reason." in text
    assert text.count(">nothing proven<") == 2 and "Nothing is proven of the rigid arm: computed-torque." in text


TITLES = {name: case.title for name, case in CASES.items()}


def standing(policy, lost=0, **rms):
    """A standing with these rms tip errors [mm], None where the path was lost."""
    largest = Estimate(max(error or 0.0 for error in rms.values()), None, None)
    return Standing(policy, "", None if lost else largest, rms, lost, len(rms), False, "", None, {})


def tied(*errors):
    return [standing(name, nominal=error) for name, error in zip("abc", errors, strict=True)]


@pytest.mark.parametrize(
    ("standings", "words"),
    [
        (
            [standing("a", nominal=4.0, machining=1.0), standing("b", nominal=0.5, machining=9.0)],
            "a wins overall with a score of 4.00 mm and in Case 2 (machining force) with 1.00 mm rms; "
            "b wins in Case 1 (nominal) with 0.500 mm rms.",
        ),
        (tied(2.0, 2.0004, 2.01), "a and b tie in Case 1 (nominal) with 2.00 mm rms."),
        (tied(0.00016, 0.00048, 0.0011), "a and b tie in Case 1 (nominal) with &lt; 0.001 mm rms."),
        (
            [standing(NASTY, nominal=1.0), *(standing(f"p{k}", nominal=1.0) for k in range(8))],
            f"{escape(NASTY)}, p0, p1 and 6 others tie in Case 1 (nominal) with 1.00 mm rms.",
        ),
        (
            [standing("a", 2, nominal=None, machining=None), standing("b", 1, nominal=1.0, machining=None)],
            "b wins in Case 1 (nominal) with 1.00 mm rms; nobody held the path in Case 2 (machining force); "
            "b (in 1 of 2 episodes) and a (in 2 of 2 episodes) lost the path and are not ranked overall.",
        ),
    ],
)
def test_the_sentence_says_who_won_or_tied_where_and_who_lost_the_path(standings, words):
    found = _headline(standings, TITLES)
    assert found.startswith("<strong>") and re.sub(r"</?strong>", "", found).replace("\u00a0", " ") == words


@pytest.mark.slow
def test_the_winner_leads_the_leaderboard_and_stands_on_the_page(folder):
    stored = read_evaluation(folder)
    standings = standings_of(stored)
    first = rank_policies([folder]).standings[0]
    text = _headline(standings, TITLES)
    assert text.startswith(
        f"<strong>{first.policy}</strong> wins overall with a score of {first.score.mean:#.3g}\u00a0mm"
    )
    page = (folder / "report.html").read_text()
    assert f'<p id="headline">{text}</p>' in page and _rule(standings) in page
