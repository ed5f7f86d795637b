"""What a reader sees in Chromium: one screen with arms and curves, where it opens, values, and the page on a phone."""

import dataclasses
import json

import numpy as np
import pytest
from support.altered_evaluations import wild, with_runs, write

from fuzzyarm.cli import main
from fuzzyarm.eval.episodes.rollout_file import read_rollouts

RESULTS = "[aria-label='Table of results']"
DESK, PHONE = {"width": 1400, "height": 900}, {"width": 390, "height": 844}
TIME = "document.getElementById('time').textContent"
CHATTERING = 7  # the policy that does, the last one


def boxes(page, selector):
    """Return left, top, right and bottom of the visible elements [CSS px]."""
    found = page.run(
        f"[...document.querySelectorAll({json.dumps(selector)})].map((e) => e.getBoundingClientRect())"
        ".filter((box) => box.width && box.height).map((box) => [box.left, box.top, box.right, box.bottom])"
    )
    return np.array(found).reshape(-1, 4)


def visible(page, selector):
    return len(boxes(page, selector)) > 0


@pytest.fixture(scope="module")
def eight_folder(evaluation, tmp_path_factory):
    """Eight policies in the machining case: one chatters, one ends early, one has a long name."""
    run = next(r for r in evaluation.rollouts if (r.case, r.policy) == ("machining", "fuzzy-4"))
    alternating = np.where(np.arange(len(run.time)) % 2, 80.0, -80.0)[:, np.newaxis]
    names = ("smooth", "plain", "p2", "p3", "p4", "a-policy-with-a-name-that-fits-into-no-card")
    runs = [dataclasses.replace(run, policy=name) for name in names]
    runs.append(wild(run, "early", 700))
    runs.append(dataclasses.replace(run, policy="chattering", torque=run.torque + alternating))
    folder = write(with_runs(evaluation, runs), tmp_path_factory.mktemp("eight") / "evaluation")
    assert main(["report", str(folder)]) == 0
    return folder


@pytest.fixture(params=["folder", "eight_folder", "nasty_folder"])
def any_page(request, chromium):
    """A function that opens the report of three, eight and two policies in a window of a size."""
    path = request.getfixturevalue(request.param) / "report.html"
    yield lambda size, **options: chromium.open(path, **size, **options) or chromium
    assert chromium.problems == [] and chromium.requests == [path.as_uri()]


@pytest.fixture
def eight(chromium, eight_folder):
    chromium.open(eight_folder / "report.html", **DESK)
    yield chromium
    assert chromium.problems == []


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_winners_arms_and_curves_are_on_one_screen(any_page, scheme):
    page = any_page(DESK, scheme=scheme)
    assert page.run("scrollY") == 0
    for selector in ("#headline", "#cases", "#play", "#worst", "#policies", "#arms figure", "#plots figure", "#key li"):
        found = boxes(page, selector)
        assert len(found) and found.min() >= 0 and found[:, 2].max() <= 1400 and found[:, 3].max() <= 900, selector
    assert len(boxes(page, "#plots canvas")) == 6
    assert boxes(page, "#arms figure")[:, 2].max() < boxes(page, "#plots figure")[:, 0].min()
    assert len(set(boxes(page, "#key li")[:, 1].round())) == 1


def test_a_case_opens_at_the_largest_error_of_any_policy(chromium, folder):
    chromium.open(folder / "report.html", **DESK)
    for index, case in enumerate(("nominal", "machining")):
        runs = [run for run in read_rollouts(folder / "rollouts.npz") if run.case == case]
        worst = max(runs, key=lambda run: run.tip_error.max())
        sample = int(worst.tip_error.argmax())
        chromium.press(str(index + 1))
        assert chromium.run(TIME) == f"{worst.time[sample]:.3f} s"
        label = chromium.run("document.getElementById('worst').textContent")
        assert label == f"Largest error: {worst.policy}, {1e3 * worst.tip_error[sample]:#.3g} mm"
        chromium.press("Home")
        assert chromium.run(TIME) == "0.001 s"
        chromium.press("e")
        assert chromium.run("state.sample") == sample
        chromium.press("Home")
        chromium.run("document.getElementById('worst').click()")
        assert chromium.run("state.sample") == sample
    chromium.run("document.querySelectorAll('.chip input')[2].click()")  # the worst of those that are shown
    assert "fuzzy-4-tip" not in chromium.run("document.getElementById('worst').textContent")


@pytest.mark.parametrize("plot", [2, 3])
def test_a_chattering_torque_is_a_band_behind_the_others(eight, plot):
    assert eight.run(f"chosen().map((policy) => plots[{plot}].banded(policy))") == [*7 * [False], True]
    assert eight.run(f"plots[{plot}].order()[0]") == CHATTERING
    assert "band: chattering" in eight.run(f"plots[{plot}].remark.textContent")
    inside = (
        f"(() => {{ const {{ values, band }} = plots[{plot}].curve({CHATTERING});"
        "return values.every((value, k) => band.low[k] <= value && value <= band.high[k]); })()"
    )
    assert eight.run(inside) is True
    # The smooth curves, which are all the same, cover the band: the pixels on them are of the one that is drawn last.
    seen = (
        f"(() => {{ const plot = plots[{plot}], top = plot.order().at(-1), {{ width, height }} = plot.still;"
        "const data = plot.still.getContext('2d').getImageData(0, 0, width, height).data;"
        "const want = colourOf(top).match(/\\d+/g).map(Number);"
        "const at = (x, y) => want.every((part, c) =>"
        "  Math.abs(data[4 * (Math.floor(y) * width + Math.floor(x)) + c] - part) < 60);"
        "const hits = plot.points(plot.curve(top).values).filter(([x, y]) => at(x, y - 1) || at(x, y) || at(x, y + 1));"
        "return hits.length / plot.curve(top).values.length; })()"
    )
    assert eight.run(seen) > 0.9
    eight.run(f"(() => {{ state.highlighted = {CHATTERING}; plots[{plot}].prepare(); }})()")
    assert (
        eight.run(f"plots[{plot}].banded({CHATTERING})") is False
        and eight.run(f"plots[{plot}].order().at(-1)") == CHATTERING
    )


def number(text):
    digits, _, exponent = text.replace("−", "-").partition("·10")
    return float(digits) * 10.0 ** int(exponent.translate(str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")) or 0)


def check_values(page, runs, sample):
    """Compare the values in the readout of each plot with those of the rollouts."""
    bending = [run.q_motor - run.q_link for run in runs]
    expected = [
        [1e3 * run.tip_error for run in runs],
        [1e3 * run.circularity_error for run in runs],
        *([run.torque[:, joint] for run in runs] for joint in (0, 1)),
        *([1e3 * bent[:, joint] for bent in bending] for joint in (0, 1)),
    ]
    shown = page.run(
        "[...document.querySelectorAll('.values')].map((list) => [...list.children].map((li) => li.innerText))"
    )
    for (time, *texts), signals in zip(shown, expected, strict=True):
        assert time == f"{runs[0].time[sample]:.3f} s"
        for text, signal in zip(texts, signals, strict=True):
            if sample >= len(signal):
                assert text == "ended"
            else:
                coarse = 0.06 if abs(signal[sample]) < 1e-3 else 6e-3
                assert number(text) == pytest.approx(signal[sample], rel=coarse, abs=1e-9), text


@pytest.mark.parametrize("sample", [0, 65, 699, 1499])
def test_values_at_the_cursor_are_those_of_the_rollouts(eight, eight_folder, sample):
    runs = read_rollouts(eight_folder / "rollouts.npz")
    eight.run(f"goTo({sample})")
    check_values(eight, runs, sample)


def test_values_at_the_pointer(eight, eight_folder):
    runs = read_rollouts(eight_folder / "rollouts.npz")
    opened = eight.run("state.sample")
    left, top, right, bottom = boxes(eight, "#plots canvas")[3]
    eight.call("Input.dispatchMouseEvent", type="mouseMoved", x=0.5 * (left + right), y=0.5 * (top + bottom))
    eight.wait_for("state.pointed !== null")
    pointed = eight.run("state.pointed")
    assert 600 < pointed < 900 and pointed != opened
    check_values(eight, runs, pointed)
    assert eight.run("state.sample") == opened and eight.run(TIME) == f"{runs[0].time[opened]:.3f} s"


def test_all_columns_of_the_table_are_reachable_on_a_phone(any_page):
    page = any_page(PHONE)
    assert page.run("document.documentElement.scrollWidth") <= PHONE["width"]
    assert "sideways" in page.run("document.querySelector('.sideways').textContent") and visible(page, ".sideways")
    (region,) = boxes(page, RESULTS)
    assert boxes(page, f"{RESULTS} thead th")[-1, 2] > region[2]
    assert "linear-gradient" in page.run(f"getComputedStyle(document.querySelector(`{RESULTS}`)).backgroundImage")
    reached, headings = set(), len(boxes(page, f"{RESULTS} thead th"))
    for left in range(0, 800, 10):
        page.run(f"document.querySelector(`{RESULTS}`).scrollLeft = {left}")
        heads = boxes(page, f"{RESULTS} thead th")
        assert heads[0, 0] == pytest.approx(region[0], abs=1)  # the names of the policies stay
        names = heads[0, 2]
        reached |= {k for k in range(1, headings) if names <= heads[k, 0] + 1 and heads[k, 2] <= region[2] + 1}
    assert reached == set(range(1, headings))
    assert boxes(page, f"{RESULTS} tbody th[scope=row]")[:, 0] == pytest.approx(region[0], abs=1)
