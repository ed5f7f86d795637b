"""The page as text: complete, escaped, with the numbers of the evaluation and a sentence on who errs least."""

import base64
import dataclasses
import hashlib
import json
import re
from html import escape, unescape
from html.parser import HTMLParser

import numpy as np
import pytest
from support.altered_evaluations import NASTY, scaled, wild, with_runs

from fuzzyarm.eval.evaluation.ranking import rank_policies, standings_of
from fuzzyarm.eval.evaluation.result_table import table_rows
from fuzzyarm.eval.evaluation.results_file import read_evaluation
from fuzzyarm.eval.report._payload import replay_data
from fuzzyarm.eval.report._summary import metrics_table
from fuzzyarm.eval.report.page import _headline, _part, _render_page
from fuzzyarm.proof.certificate import NOT_COVERED


class Elements(HTMLParser):
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


def pairs(text):
    return numbers(text).reshape(-1, 2)


@pytest.fixture(scope="module")
def text(folder):
    return (folder / "report.html").read_text()


def test_it_is_one_file_that_names_no_other(text):
    for tag, attributes in Elements(text).found:
        assert "src" not in attributes and attributes.get("href") in (None, "data:,")
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
            np.testing.assert_allclose(np.hypot(*pairs(embedded["deviation"]).T), run.tip_error, rtol=1e-6, atol=1e-12)
            np.testing.assert_allclose(pairs(embedded["torque"]), run.torque, rtol=1e-6)
            motors = pairs(embedded["link"]).astype(float) + pairs(embedded["bending"])
            np.testing.assert_allclose(motors, run.q_motor, rtol=1e-6, atol=1e-9)
            np.testing.assert_allclose(numbers(case["time"]), run.time, rtol=1e-6)
            if case["force"]:
                np.testing.assert_allclose(pairs(case["force"]), run.external_force, rtol=1e-6)


def test_many_policies_are_thinned_to_fit_and_the_page_says_so(evaluation):
    run = evaluation.rollouts[0]
    many = [*(dataclasses.replace(run, policy=f"policy-{k}") for k in range(60)), wild(run, "early", 703)]
    stored = with_runs(evaluation, many)
    text, data = _render_page(stored), replay_data(stored)
    assert len(text.encode()) < 3_000_000
    assert data["stride"] > 1 and f"one sample in {data['stride']} and the last of each episode" in text
    last = pairs(data["cases"][0]["runs"][-1]["torque"])[-1]
    np.testing.assert_allclose(last, many[-1].torque[-1], rtol=1e-6)


def test_the_table_has_the_cells_of_the_terminal(evaluation, text):
    expected = [
        (policy, re.sub(r"\.(?!\d)", "", cell)) for _, policy, row in table_rows(evaluation.rows) for cell in row
    ]
    table = metrics_table(evaluation.rows, evaluation.config.titles)
    rows = re.findall(r'<th scope="row"><span class="swatch"></span>(.*?)</th>(.*?)</tr>', table)
    found = [(policy, unescape(cell)) for policy, row in rows for cell in re.findall(r"<td[^>]*>(.*?)</td>", row)]
    assert found == expected and table in text


def test_certificates_are_there_in_words(evaluation, text):
    assert "and not for the sampled elastic arm" in text and NOT_COVERED in text
    words = escape(evaluation.certificates["fuzzy-4"])
    assert f"<summary>fuzzy-4: error decays at least as fast as exp(−20 t)</summary><p>{words}</p>" in text
    assert "Nothing is proven about the rigid arm with computed-torque." in text


def headline(stored):
    return _headline(sorted(standings_of(stored), key=lambda one: one.order), stored.config)


RULE = " Policies are ranked by their largest tip error over all cases."


def test_the_sentence_names_the_leader_of_the_leaderboard(evaluation, folder, text):
    first, *_ = rank_policies([folder]).standings
    said = f"{first.policy} has the smallest error in the worst case: {first.cells[0]} mm at the tip.{RULE}"
    assert headline(evaluation) == said and f'id="headline">{escape(said)}</p>' in text


def test_the_sentence_names_ties_and_lost_paths(evaluation):
    run = evaluation.rollouts[0]
    lost, twin, better = wild(run, "a", 700), scaled(run, "twin", 1.0), scaled(run, "b", 0.1)
    for runs, said in (
        ([run], f"fuzzy-4 has the smallest error: 3.90 mm at the tip.{RULE}"),
        ([run, twin], f"fuzzy-4 and twin have the smallest error: 3.90 mm at the tip.{RULE}"),
        (
            [run, lost, better, wild(run, "c", 9)],
            f"b has the smallest error: 0.390 mm at the tip; a and c lost the path.{RULE}",
        ),
        ([lost, scaled(run, "far", 100.0)], "Every policy lost the path: a and far."),
    ):
        assert headline(with_runs(evaluation, runs)) == said


def test_the_range_over_the_seeds_is_embedded(evaluation):
    run = evaluation.rollouts[0]
    runs = [scaled(run, "p", factor, seed=seed) for seed, factor in enumerate((1.0, 0.5))]
    runs.append(dataclasses.replace(wild(run, "p", 700), seed=2))
    stored = with_runs(evaluation, runs)
    stored = dataclasses.replace(stored, config=dataclasses.replace(stored.config, seeds=3, encoder_noise=(1e-5, 1e-3)))
    low, high = pairs(replay_data(stored)["cases"][0]["runs"][0]["range"]).T
    np.testing.assert_allclose(low[700:], 0.5 * run.tip_error[700:], rtol=1e-6)
    np.testing.assert_allclose(high[700:], run.tip_error[700:], rtol=1e-6)  # the third seed has ended
    np.testing.assert_allclose(high[:700], np.maximum(run.tip_error[:700], runs[2].tip_error), rtol=1e-6)
    assert "on a band from the smallest to the largest tip error of any seed" in _render_page(stored)


@pytest.mark.parametrize("theme", [0, 1])
def test_sixteen_policies_have_colours_that_differ(theme):
    found = re.findall(r"--p\d+: light-dark\(#(\w{6}), #(\w{6})\)", _part("page.css"))
    values = np.array([list(bytes.fromhex(pair[theme])) for pair in found]) / 255.0
    linear = np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)
    to_xyz = [[0.4124564, 0.2126729, 0.0193339], [0.3575761, 0.7151522, 0.1191920], [0.1804375, 0.0721750, 0.9503041]]
    x, y, z = np.cbrt(linear @ to_xyz / [0.95047, 1.0, 1.08883]).T  # every colour is lighter than the linear part
    lab = np.stack([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)], axis=1)
    distances = np.linalg.norm(lab[:, np.newaxis] - lab, axis=-1) + 1e3 * np.eye(16)
    assert distances.min() > 25.0
