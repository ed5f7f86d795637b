"""The page as text: complete, escaped, and with the numbers of the evaluation."""

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

from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.eval.evaluation.result_table import table_rows
from fuzzyarm.eval.evaluation.results_file import read_evaluation
from fuzzyarm.eval.evaluation.run import EvaluationConfig
from fuzzyarm.eval.report.certificates import Observed
from fuzzyarm.eval.report.page import command, render_page
from fuzzyarm.eval.report.payload import _shown, _within, replay_data
from fuzzyarm.eval.report.summary import Axis, Bound, Errors, best, digits, draw_chart, error_charts, metrics_table
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
    text = render_page(stored, {})
    assert len(text.encode()) < 3_000_000
    stride = replay_data(stored)["stride"]
    assert stride > 1 and f"one sample in {stride} and the last of each episode" in text
    last = replay_data(stored)["cases"][0]["runs"][-1]
    np.testing.assert_allclose(numbers(last["torque"])[-2:], many[-1].torque[-1], rtol=1e-6)


@pytest.mark.parametrize(("samples", "stride"), [(1, 1), (1, 7), (10, 3), (11, 3), (1500, 4)])
def test_thinning_keeps_the_first_and_the_last_sample(samples, stride):
    shown = _shown(samples, stride)
    assert shown[0] == 0 and shown[-1] == samples - 1 and np.diff(shown).max(initial=0) <= stride
    for shorter in range(1, samples, max(1, samples // 7)):
        kept = _within(shown, shorter)
        assert kept[-1] == shorter - 1 and np.all(np.diff(kept) >= 0)
        assert np.array_equal(kept[:-1], shown[: len(kept) - 1])


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
    assert best(rows(values, early), ("m",), texts) == expected


def test_certificates_stand_beside_what_was_observed(evaluation):
    text = render_page(evaluation, SEEN)
    assert "not for the sampled elastic arm" in text and NOT_COVERED in text
    assert "20.5 ≥ 20<" in text and "70.0 ≤ 140<" in text
    assert "> ≥ 20<" not in text and ">≥ 20<" in text  # the bound alone where nothing was observed
    assert "fuzzy-4-tip: not observed: for a reason." in text
    assert text.count(">nothing proven<") == 2 and "Nothing is proven of the rigid arm: computed-torque." in text


def test_an_axis_is_linear_or_logarithmic():
    line, decades = Axis("", 0.0, 10.0), Axis("", 1e-2, 1e2, log=True)
    assert line.x(5.0) == pytest.approx(0.5 * (line.x(0.0) + line.x(10.0)))
    assert decades.x(1.0) == pytest.approx(0.5 * (decades.x(0.01) + decades.x(100.0)))
    assert decades.x(0.0) == decades.x(0.01) and line.x(99.0) == line.x(10.0)
    assert decades.ticks() == pytest.approx([0.01, 0.1, 1.0, 10.0, 100.0])
    assert line.ticks() == [0.0, 2.0, 4.0, 6.0, 8.0, 10.0]


def test_a_bound_lies_between_what_it_rules_out_and_what_was_seen():
    axis = Axis("", 0.0, 25.0)
    for bound, hatched in (
        (Bound(20.0, 21.0, at_least=True), (0.0, 20.0)),
        (Bound(20.0, 15.0, at_least=False), (20.0, 25.0)),
    ):
        svg = draw_chart(axis, [("a", bound)], "")
        left, width = map(float, re.search(r'ruled-out" x="([\d.]+)" y="[\d.]+" width="([\d.]+)"', svg).groups())
        assert (left, left + width) == pytest.approx((axis.x(hatched[0]), axis.x(hatched[1])), abs=0.11)
        seen = float(re.search(r'circle class="dot" cx="([\d.]+)"', svg).group(1))
        assert seen == pytest.approx(axis.x(bound.observed), abs=0.06)
        assert not left < seen < left + width


def test_below_a_micrometre_the_chart_gives_no_number_and_all_share_the_star(evaluation):
    rows = [
        dict(evaluation.rows[0], policy=name, tip_error_rms_mm=rms)
        for name, rms in (("a", 0.00016), ("b", 0.00048), ("c", 0.0011))
    ]
    charts = error_charts(rows, evaluation.config.titles)
    assert charts.count("★ </tspan>&lt; 0.001<") == 2 and ">0.00110<" in charts


def test_digits():
    assert [digits(v) for v in (0.000419, 1.0, 67.44, 526.0, 1040.2)] == ["0.000419", "1.00", "67.4", "526", "1040"]


def test_errors_are_drawn_from_rms_to_maximum():
    axis = Axis("", 0.1, 100.0, log=True)
    svg = draw_chart(axis, [("a", Errors(1.0, 10.0, best=True)), (NASTY, Errors(2.0, 3.0, best=False))], "x < y")
    assert f'd="M{axis.x(1.0):.1f} 18.5H{axis.x(10.0):.1f}"' in svg
    assert svg.count("★") == 1 and "<img" not in svg and "x &lt; y" in svg


def test_the_command_makes_the_same_evaluation():
    assert command(EvaluationConfig()) == "fuzzyarm evaluate"
    config = EvaluationConfig(policies=("a b.json",), cases=("nominal",), seeds=3, encoder_noise=(1e-5, 1e-3))
    given = "fuzzyarm evaluate --policy 'a b.json' --case nominal --seeds 3 --encoder-noise 1e-05 0.001"
    assert command(config) == given
    other = dataclasses.replace(config, parameters=ArmParameters(gravity=1.62))
    assert command(other) == f"{given} --robot FILE"
