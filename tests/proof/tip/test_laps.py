"""Sets of starts and laps for ever: containment is decided rightly, and forged sets are refused."""

import dataclasses
import json

import numpy as np
import pytest
from scipy.optimize import linprog
from support.command_line import one_line_error
from support.forged_bounds import checked

from fuzzyarm.cli import main
from fuzzyarm.envs.scenario.given_path import GivenPath
from fuzzyarm.policies.tip_bound import TipClaim, _Lap, find_bound
from fuzzyarm.policies.tip_files import check_bound, save_bound
from fuzzyarm.proof.tip import laps as module
from fuzzyarm.proof.tip.laps import LapSet, StartBox
from fuzzyarm.proof.tip.zonotope import Zonotope

NUMBERS, NONE = 9, np.zeros(0)


def end_of(columns, centre=0.0, constants=2):
    """Return the end of a lap: the point, and deviations of columns (9, n), the first those of the constants."""
    deviations = Zonotope(NUMBERS, constants)
    deviations.columns[:] = columns[:, :constants]
    deviations.add(columns[:, constants:], 0)
    point = np.full(NUMBERS, centre)
    return (point[:8], point[8:], NONE), deviations


def linear(seed=0, size=0.2):
    """Return A of a spectral radius, B and N of x⁺ = A x + B π + N w in 9 numbers, and the generator."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(NUMBERS, NUMBERS))
    A *= size / np.abs(np.linalg.eigvals(A)).max()
    return A, 1e-3 * rng.normal(size=(NUMBERS, 2)), 1e-3 * rng.normal(size=(NUMBERS, 60)), rng


def lap_of(A, B, N, start):
    """Return the end of a lap of the linear system that begins anywhere in a set."""
    return end_of(np.hstack([A @ start.constants + B, A @ start.columns, N]))


@pytest.mark.parametrize(("narrow", "kept", "size"), [(1.0, 0, 0.2), (1e-6, 60, 0.1)])
def test_a_linear_system_stays_in_the_set_that_holds_its_own_end(narrow, kept, size, monkeypatch):
    """The theorem on x⁺ = A x + B π + N w: once filled <= 1, no simulated lap leaves the set."""
    monkeypatch.setattr(module, "_NARROW", narrow)
    monkeypatch.setattr(module, "_KEPT", kept)
    A, B, N, rng = linear(size=size)
    end = end_of(np.hstack([B, N]))
    for _ in range(12):
        held = LapSet.around(*end)
        end = lap_of(A, B, N, held)
        if (filled := held.filled(*end)) <= 1.0:
            break
    assert 0.5 < filled <= 1.0
    for _ in range(3):
        factors = rng.choice([-1.0, 1.0], 2)
        x = held.constants @ factors + held.columns @ rng.choice([-1.0, 1.0], held.columns.shape[1])
        for _ in range(10):
            x = A @ x + B @ factors + N @ rng.choice([-1.0, 1.0], N.shape[1])
            assert inside(held, x - held.constants @ factors)


def inside(held, x):
    """Return whether x = G g, |g_i| <= 1, by linear programming, which shares nothing with the proof."""
    scale = np.abs(held.columns).sum(axis=1)
    G = held.columns / scale[:, np.newaxis]
    return linprog(np.zeros(G.shape[1]), A_eq=G, b_eq=x / scale, bounds=(-1.0, 1.0)).status == 0


@pytest.mark.parametrize("kept", [0, 20, 60])
def test_what_is_said_to_lie_inside_does_and_what_leaves_is_refused(kept, monkeypatch):
    monkeypatch.setattr(module, "_KEPT", kept)
    _, B, N, rng = linear(3)
    end = end_of(np.hstack([B, N]))
    held = LapSet.around(*end)
    assert held.filled(*end) <= 1.0
    for share in (0.9, 1.0):
        assert inside(held, share * N @ rng.choice([-1.0, 1.0], N.shape[1]))
    far = 3.0 * np.abs(held.columns).sum(axis=1).max()
    # A wider end, one beside it, other constants, and sets that are none.
    ends = [(np.hstack([B, 1.2 * N]), 0.0), (np.hstack([B, N]), far), (np.hstack([B + far, N]), 0.0)]
    assert not any(held.filled(*end_of(columns, centre)) <= 1.0 for columns, centre in ends)
    for wrong in ({"columns": 0.0 * held.columns}, {"memory": np.zeros(2)}):
        assert not held._replace(**wrong).filled(*end) <= 1.0


BOX = StartBox(5e-4, (2e-5, 5e-5), 0.01, 0.01, 2e-5)


def test_a_box_is_read_said_and_spanned(tmp_path):
    widths = "angle = 5e-4\nbending = [2e-5, 5e-5]\nvelocity = 0.01\nbending_velocity = 0.01\nmemory = 2e-5\n"
    (tmp_path / "box.toml").write_text(widths)
    assert StartBox.of([str(tmp_path / "box.toml")]) == BOX
    assert StartBox.of(["5e-4", "2e-5", "0.01", "0.01", "2e-5"]) == dataclasses.replace(BOX, bending=2e-5)
    assert "angle ± 0.0005 rad, bending ± 2e-05 and 5e-05 rad, velocity ± 0.01 rad/s" in BOX.in_words()
    columns = BOX.columns(2, 10, 2)
    x = columns @ np.sign(np.random.default_rng(0).normal(size=columns.shape[1]))
    assert np.abs(x[:2]) == pytest.approx([5e-4] * 2) and np.abs(x[:2] - x[2:4]) == pytest.approx([2e-5, 5e-5])
    assert np.abs(x[4:6] - x[6:8]) == pytest.approx([0.01] * 2) and np.abs(x[8:]) == pytest.approx([2e-5] * 2)


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (["--start", "1", "2"], "must be a .toml or .json file, or one number for each of angle, bending,"),
        (["--start", "5e-4", "0", "0", "0", "-1"], "memory = -1.0"),
        (["--start", "no.toml"], "no.toml"),
        (["--start", "x", "0", "0", "0", "0"], "start: could not convert"),
        (["--laps", "ever", "--steps", "3"], "laps = ever covers whole laps only"),
        (["--laps", "ever", "--path", "line"], "needs a closed path"),
        (["--path", "cube"], "path = 'cube'"),
        (["--robot", "ur5"], "was designed for the two-joint arm, not for ur5"),
    ],
)
def test_bad_starts_laps_and_arms_are_one_line(words, why, capsys):
    assert main(["prove", *words]) == 2
    assert why in one_line_error(capsys)


@pytest.fixture(scope="module")
def boxed():
    return find_bound(TipClaim("fuzzy-4-tip", steps=4, start=BOX))


def test_a_box_of_starts_is_in_the_file_and_a_wider_one_is_refused(boxed, tmp_path):
    path = tmp_path / "bound.json"
    save_bound(boxed, path)
    found = check_bound(path)
    assert found.proven and found.claim.start == BOX and "from any state with angle ± 0.0005 rad" in found.sentence
    assert boxed.whole[0] > 1e3 * find_bound(TipClaim("fuzzy-4-tip", steps=1)).whole[0]
    content = json.loads(path.read_text())
    for name in ("angle", "bending_velocity", "memory"):
        path.write_text(json.dumps(content | {"start": content["start"] | {name: 0.1}}))
        assert not check_bound(path).proven
    for wrong in ({"start": {"angle": -1.0}}, {"start": content["start"] | {"memory": [1e-5] * 3}}, {"laps": "two"}):
        path.write_text(json.dumps(content | wrong))
        assert main(["verify", str(path)]) == 2
    path.write_text(json.dumps(content | {"whole": [0.99 * x for x in content["whole"]]}))
    assert check_bound(path).reason == "a bound on the tip error is larger than the file says"


@pytest.mark.slow
def test_a_containment_that_is_false_is_refused(tmp_path):
    """A lap of 60 ms whose end is said to lie in a set that it leaves, or in one that its own lap would leave."""
    ring = [(0.35 + 2e-5 * np.sin(a), 0.85 - 2e-5 * (1.0 - np.cos(a))) for a in np.arange(8) * np.pi / 4]
    one = find_bound(TipClaim("fuzzy-4-tip", duration=0.06, points=GivenPath(tuple(ring), closed=True, duration=0.06)))
    last = {field.name: getattr(one, field.name) for field in dataclasses.fields(_Lap)}
    for size, why in (
        (1e-16, "is not inside the set in which the next lap begins"),
        (1e-3, "no bound beyond lap 2, t = 0.000"),
    ):
        begin = LapSet(one.steps[-1].segments[-1].end, np.zeros(2), NONE, np.zeros((10, 0)), size * np.eye(10))
        claim, later = dataclasses.replace(one.claim, laps="ever"), (_Lap(**last | {"begin": begin}),)
        answer = checked(dataclasses.replace(one, claim=claim, later=later), tmp_path / "forged.json")
        assert not answer.proven and why in answer.reason
    assert checked(one, tmp_path / "true.json").proven
