"""The page in Chromium: it loads, plays, seeks and handles keys; nothing is fetched or logged."""

import numpy as np
import pytest
from support.altered_evaluations import NASTY

from fuzzyarm.eval.episodes.rollout_file import read_rollouts
from fuzzyarm.policies import COMPARED

POLICIES = ("fuzzy-4", "computed-torque", "fuzzy-4-tip")
PICTURES = "[...document.querySelectorAll('#arms canvas, #plots canvas')].map((canvas) => canvas.toDataURL())"
READOUT = "[...document.querySelectorAll('.readout')].map((line) => line.textContent)"
PLAY = "document.getElementById('play')"
TIME = "document.getElementById('time').textContent"
SAMPLE = "Number(document.getElementById('scrubber').value)"


@pytest.fixture
def page(chromium, folder):
    """The report, opened again for each test, which must not log anything or use the network."""
    path = folder / "report.html"
    chromium.open(path)
    yield chromium
    assert chromium.problems == []
    assert chromium.requests == [path.as_uri()]
    assert chromium.run("performance.getEntriesByType('resource').length") == 0


@pytest.fixture(scope="module")
def rollouts(folder):
    return {(run.case, run.policy): run for run in read_rollouts(folder / "rollouts.npz")}


def seek(page, sample):
    page.run(f"(() => {{ const s = document.getElementById('scrubber'); s.value = {sample};"
             "s.dispatchEvent(new Event('input')); })()")  # fmt: skip


def shown(page):
    """Return (tip error [mm], (torque 1, torque 2) [N m]) as the readouts show them, by policy."""
    result = {}
    for policy, line in zip(POLICIES, page.run(READOUT), strict=True):
        error, torques = line.split("Γ ")
        *_, size, unit = error.split()  # of "< 0.001 mm" the limit
        first, second = torques.replace("−", "-").removesuffix(" N m").split(", ")
        result[policy] = float(size) * {"mm": 1.0, "µm": 1e-3}[unit], (float(first), float(second))
    return result


def test_playing_moves_the_arms_and_the_cursors_and_stops_at_the_end(page):
    before = page.run(PICTURES)
    page.run(f"{PLAY}.click()")
    page.wait_for(f"{SAMPLE} > 100")
    assert all(now != then for now, then in zip(page.run(PICTURES), before, strict=True))
    assert "Pause" in page.run(f"{PLAY}.textContent")
    page.run(f"{PLAY}.click()")
    stopped = page.run(SAMPLE)
    page.run("new Promise((resolve) => setTimeout(resolve, 100))")
    assert page.run(SAMPLE) == stopped
    seek(page, 1450)
    page.run(f"{PLAY}.click()")
    page.wait_for(f"{PLAY}.textContent.includes('Play')")
    assert page.run(TIME) == "1.500 s"
    page.run(f"document.getElementById('loop').click(), {PLAY}.click()")
    page.wait_for(f"{SAMPLE} > 0 && {SAMPLE} < 1400")


@pytest.mark.parametrize("sample", [0, 1, 620, 1499])
def test_the_scrubber_shows_the_sample_of_the_file(page, rollouts, sample):
    for key, case in (("1", "nominal"), ("2", "machining")):
        page.press(key)
        seek(page, sample)
        for policy, (error, torque) in shown(page).items():
            run = rollouts[case, policy]
            assert page.run(TIME) == f"{run.time[sample]:.3f} s"
            # below a micrometre the page says "< 0.001 mm"
            assert error == pytest.approx(max(1e3 * run.tip_error[sample], 1e-3), rel=6e-3)
            assert torque == pytest.approx(run.torque[sample], abs=0.051)


@pytest.mark.parametrize("sample", [100, 900])
def test_the_arm_is_where_the_links_are(page, rollouts, sample):
    """The white hole of the elbow is at the angle of the first link, in a frame with x down and y to the right."""
    page.press("1")
    seek(page, sample)
    view = page.run("view")
    low, high = np.array(view["low"]), np.array(view["high"])
    for index, policy in enumerate(POLICIES):
        q1 = rollouts["nominal", policy].q_link[sample, 0]
        elbow = 0.5 * np.array([np.cos(q1), np.sin(q1)])
        canvas = f"document.querySelectorAll('#arms canvas')[{index}]"
        box = np.array(page.run(f"[{canvas}.height, {canvas}.width]"))
        down, right = 0.5 * box + min(box / (high - low)) * (elbow - 0.5 * (low + high))
        found = page.run(f"[...{canvas}.getContext('2d').getImageData({right}, {down}, 1, 1).data]")
        assert min(found) > 240, (policy, found)


def test_keys(page):
    def after(*presses, **options):
        for key in presses:
            page.press(key, **options)
        return page.run(SAMPLE)

    assert after("End") == 1499
    assert after("ArrowLeft", "ArrowLeft", "ArrowRight") == 1498
    assert after("ArrowLeft", shift=True) == 1448
    assert [after("Home"), after("ArrowLeft")] == [0, 0]
    page.press("2")
    assert page.run("document.querySelector('[aria-selected=true]').textContent") == "Case 2: machining force"
    for focused in ("body", "#scrubber", "#play"):
        page.run(f"document.querySelector('{focused}').focus()")
        page.press(" ")
        page.wait_for(f"{SAMPLE} > 0")
        page.press(" ")
        assert page.run("state.playing") is False
        assert [after("Home"), after("ArrowRight"), after("Home")] == [0, 1, 0]


def test_axe_finds_nothing(chromium, many_folder):
    for width in (1280, 390):
        chromium.open(many_folder / "report.html", width=width)
        assert chromium.barriers() == []


def test_nothing_can_be_fetched(chromium, folder):
    chromium.open(folder / "report.html")
    blocked = (
        "new Promise((resolve) => { document.addEventListener('securitypolicyviolation', (event) =>"
        "resolve(event.effectiveDirective)); fetch('http://127.0.0.1:9/').catch(() => {}); })"
    )
    assert chromium.run(blocked) == "connect-src"
    inline = blocked.replace("fetch('http://127.0.0.1:9/').catch(() => {})", "document.body.append(Object.assign("
                             "document.createElement('script'), { textContent: 'window.intruder = 1' }))")  # fmt: skip
    assert chromium.run(inline) == "script-src-elem"
    assert chromium.run("window.intruder") is None


def test_nasty_names_and_early_ends(chromium, nasty_folder):
    path = nasty_folder / "report.html"
    chromium.open(path)
    assert chromium.run("document.querySelectorAll('#arms figcaption b')[1].textContent") == NASTY
    assert chromium.run("document.images.length") == 0
    assert "1 of 1" in chromium.run("document.querySelector('table').textContent")
    seek(chromium, 699)
    last = chromium.run(READOUT)[1]
    seek(chromium, 1200)
    assert chromium.run(READOUT)[1] == last  # it stays where it ended
    assert chromium.run(READOUT)[0] != last
    assert chromium.problems == [] and chromium.requests == [path.as_uri()]


def test_a_case_opens_at_the_largest_error_of_any_policy(chromium, folder, rollouts):
    chromium.open(folder / "report.html", width=1400, height=900)
    worst_button = "document.getElementById('worst')"
    for key, case in (("1", "nominal"), ("2", "machining")):
        worst = max((rollouts[case, policy] for policy in POLICIES), key=lambda run: run.tip_error.max())
        sample = int(worst.tip_error.argmax())
        chromium.press(key)
        assert chromium.run(TIME) == f"{worst.time[sample]:.3f} s"
        said = f"Largest error: {worst.policy}, {1e3 * worst.tip_error[sample]:#.3g} mm"
        assert chromium.run(f"{worst_button}.textContent") == said
        for back in (lambda: chromium.press("e"), lambda: chromium.run(f"{worst_button}.click()")):
            chromium.press("Home")
            assert chromium.run(TIME) == "0.001 s"
            back()
            assert chromium.run("state.sample") == sample
    chromium.run("document.querySelectorAll('.chip input')[2].click()")  # the worst of those that are shown
    assert "fuzzy-4-tip" not in chromium.run(f"{worst_button}.textContent")


def number(text):
    digits, _, exponent = text.replace("−", "-").partition("·10")
    return float(digits) * 10.0 ** int(exponent.translate(str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")) or 0)


@pytest.mark.parametrize("sample", [0, 65, 699, 1499])
def test_values_at_the_cursor_are_those_of_the_rollouts(chromium, nasty_folder, sample):
    runs = [run for run in read_rollouts(nasty_folder / "rollouts.npz") if run.case == "machining"]
    chromium.open(nasty_folder / "report.html", width=1400, height=900)
    chromium.press("2")
    chromium.run(f"goTo({sample})")
    expected = [
        [1e3 * run.tip_error, 1e3 * run.circularity_error, *run.torque.T, *1e3 * (run.q_motor - run.q_link).T]
        for run in runs
    ]
    lists = "[...document.querySelectorAll('.values')].map((list) => [...list.children].map((li) => li.innerText))"
    for (time, *texts), *signals in zip(chromium.run(lists), *expected, strict=True):
        assert time == f"{runs[0].time[sample]:.3f} s"
        for text, signal in zip(texts, signals, strict=True):
            if sample >= len(signal):
                assert text == "ended"
            else:
                coarse = 0.06 if abs(signal[sample]) < 1e-3 else 6e-3
                assert number(text) == pytest.approx(signal[sample], rel=coarse, abs=1e-9), text
    assert chromium.problems == []


def test_the_page_opens_with_the_best_four_in_the_hardest_case(chromium, many_folder):
    chromium.open(many_folder / "report.html")
    assert chromium.run("document.querySelector('[aria-selected=true]').textContent") == "Case 3: 5 kg payload"
    ticked = "[...document.querySelectorAll('.chip')].filter((chip) => chip.control.checked)"
    assert chromium.run(f"{ticked}.map((chip) => chip.innerText)") == [COMPARED[k] for k in (3, 5, 6, 8)]


# Text of a chart is cut at the edge of the chart, not at its own box; its `scrollWidth` depends on when it was drawn.
CLIPPED = """[...document.querySelectorAll(
  '.values li, .readout, .readout *, .chip, .remark, #key li, td, .chart text')]
.filter((part) => part.getClientRects().length && !part.closest('details:not([open])')).filter((part) => {
  const room = (part.closest('.values, svg, .scroll > table') ?? document.body).getBoundingClientRect();
  const own = part.getBoundingClientRect();
  return own.right > room.right + 1 || own.left < room.left - 1 || own.bottom > room.bottom + 1
    || part instanceof HTMLElement && part.clientWidth && part.scrollWidth > part.clientWidth + 1;
}).map((part) => part.textContent)"""


@pytest.mark.parametrize(("width", "height"), [(1400, 900), (390, 844)])
def test_no_value_is_clipped_with_twelve_policies(chromium, many_folder, width, height):
    chromium.open(many_folder / "report.html", width=width, height=height)
    chromium.run("document.querySelectorAll('.chip input').forEach((box) => box.checked || box.click())")
    for sample in (0, 10, 699, 1400):
        chromium.run(f"goTo({sample})")
        assert chromium.run(CLIPPED) == []
    assert chromium.run("document.documentElement.scrollWidth") == width
    assert chromium.run("plots.every(({ canvas }) => canvas.clientHeight >= 120)")


@pytest.mark.parametrize("many_folder", [9], indirect=True)
def test_the_page_is_short_on_a_phone(chromium, many_folder):
    chromium.open(many_folder / "report.html", width=390, height=844)
    assert chromium.run("document.documentElement.scrollHeight") < 6000
