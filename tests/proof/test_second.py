"""The second checker of tip bounds accepts true files and refuses forged ones; its equations are the package's."""

import copy
import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest
from flint import arb, ctx
from scipy.optimize import linprog

from fuzzyarm import load_policy
from fuzzyarm.cli import main
from fuzzyarm.envs.physics.dynamics import arm_constants, rigid_inverse_dynamics
from fuzzyarm.envs.physics.friction import dry_friction_of, stribeck_magnitude
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.policies.tip_bound import TipClaim, find_bound, problem_of
from fuzzyarm.policies.tip_files import save_bound
from fuzzyarm.proof import second
from fuzzyarm.proof.tip.plant import SETS, PlantSet

STEPS, AT = 10, 6
LAWS = ("fuzzy-4-tip", "fuzzy-4-sampled-tip", "computed-torque-tip")


@pytest.fixture(scope="module")
def true(tmp_path_factory):
    path = tmp_path_factory.mktemp("true") / "bound.json"
    save_bound(find_bound(TipClaim("fuzzy-4-tip", plants=SETS["near"], steps=STEPS)), path)
    return path


def test_a_true_bound_is_proven_nearly_as_tightly_for_the_set_of_its_numbers(true, tmp_path):
    document, path = json.loads(true.read_text()), tmp_path / "renamed.json"
    path.write_text(json.dumps(document | {"set_name": "table-1"}))
    for found in map(second.check, (true, path)):
        assert found.proven and found.reason == "" and "mass [0.995, 1.005]" in found.about
        assert "dry_friction [0.8, 1.2]" in found.about and found.bound <= 1.001 * document["bound"]


def _scaled(numbers, at, factor):
    numbers[at] *= factor


def _held(document):
    part = document["steps"][AT][0]
    part["plans"][0], part["modes"][0] = "held", 2


FORGED = {
    **{
        f"radius {row + 1}": (lambda d, row=row: _scaled(d["steps"][AT][0]["tube"], row, 0.8), f"row {row + 1} ")
        for row in range(0, 18, 3)
    },
    "another mass": (lambda d: d["plants"].update(mass=[0.9, 1.1]), "control step 1"),
    "another friction": (lambda d: d["plants"].update(dry_friction=[0.3, 1.2]), "; its radius is"),
    "a lighter motor": (lambda d: d["plants"].update(motor_inertia=[0.7, 1.0]), "control step 1"),
    "a motor that rests": (_held, "plan 'held'"),
    "another side": (lambda d: d["steps"][AT][0].update(plans=["slip", "slip"], modes=[1, 1]), "may stop"),
    "another centre": (lambda d: _scaled(d["steps"][AT][0]["angles"][0], 0, 1.0002), "; its radius is"),
    "a missing step": (lambda d: d["steps"].pop(AT), "do not fit a motion of 1500 steps"),
    "a missing end": (lambda d: (d["steps"].pop(), d["steps"].append([])), "its segments last"),
    "a smaller bound": (lambda d: _scaled(d, "bound", 0.9), "the tip error may reach"),
    "a smaller tip": (lambda d: _scaled(d["tip"], AT, 0.9), "the tip error may reach"),
    "another controller": (lambda d: d["files"].update({"fuzzy-4.json": "0" * 64}), "is not the controller file"),
}


@pytest.mark.parametrize("name", FORGED)
def test_a_forged_bound_is_refused(true, tmp_path, name):
    document, path = json.loads(true.read_text()), tmp_path / "forged.json"
    before = copy.deepcopy(document)
    forge, reason = FORGED[name]
    forge(document)
    assert document != before
    path.write_text(json.dumps(document))
    found = second.check(path)
    assert found.verdict == "NOT PROVEN" and reason in found.reason, found.reason
    assert found.reason.startswith("control step ") == (name not in ("a missing step", "another controller"))


def test_what_it_does_not_know_is_named(true, tmp_path, capsys):
    document, path = json.loads(true.read_text()), tmp_path / "other.json"
    for name, value in (("policy", "elastic-observer"), ("case", "payload"), ("laps", "ten")):
        path.write_text(json.dumps(document | {name: value}))
        found = second.check(path)
        assert found.verdict == "NOT CHECKED" and not found.proven
        assert (value if name == "policy" else name) in found.reason
    assert main(["verify", "--twice", str(true)]) == 0
    assert "PROVEN by the second checker" in capsys.readouterr().out
    assert main(["verify", "--twice", str(second._CONTROLLERS / "fuzzy-1.json")]) == 2
    path.write_text("{}")
    with pytest.raises(ValueError, match="is not a file that fuzzyarm prove wrote"):
        second.check(path)


def test_it_imports_nothing_of_the_package():
    imported = re.findall(r"^ *(?:from|import) (\S+)", Path(second.__file__).read_text(), re.MULTILINE)
    roots = {name.split(".")[0] for name in imported}
    assert {"numpy", "flint"} < roots <= {*sys.stdlib_module_names, "numpy", "flint"} - {"importlib"}


def test_its_plant_is_the_environments():
    """Links' torque, its derivatives by differences, and friction at random states; the two texts share nothing."""
    robot = json.loads((second._CONTROLLERS / "fuzzy-4.json").read_text())["robot"]
    plant = second._Plant({name: second._read(value) for name, value in robot.items()}, second._DEFAULTS)
    arm, rng, h = arm_constants(ArmParameters()), np.random.default_rng(1), 1e-6
    dry = [dry_friction_of(ArmParameters(), joint) for joint in range(2)]
    for _ in range(50):
        x = rng.uniform([-3, -3, -9, -9, -90, -90], [3, 3, 9, 9, 90, 90])

        def torque(x):
            return rigid_inverse_dynamics(*x.reshape(3, 2), arm)

        parts = [[arb(number) for number in part] for part in x.reshape(3, 2).tolist()]
        found = [float(t) for t in second.link_torque(plant.c, *parts)]
        np.testing.assert_allclose(found, torque(x), rtol=1e-12, atol=1e-10)
        slopes = np.hstack(np.vectorize(float)(second._link_slopes(plant.c, *parts)))
        differences = np.stack([(torque(x + h * e) - torque(x - h * e)) / (2 * h) for e in np.eye(6)], axis=1)
        np.testing.assert_allclose(slopes, differences, rtol=1e-5, atol=1e-5)
        for joint, v in enumerate(rng.uniform(-0.5, 0.5, 2).tolist()):
            assert float(plant.friction(joint, arb(v))) == pytest.approx(stribeck_magnitude(v, dry[joint]), abs=1e-12)
            slope = (plant.friction(joint, arb(v + h)) - plant.friction(joint, arb(v - h))) / (2 * h)
            assert float(plant.slope(joint, arb(v))) == pytest.approx(float(slope), abs=1e-6)


@pytest.mark.parametrize("name", LAWS)
def test_its_law_and_reference_are_the_policys(name, monkeypatch):
    """The policy's floats lie in the balls, along the path and about it, and so do changes of the measured state."""
    monkeypatch.setattr(ctx, "prec", second._BITS)
    if name == "computed-torque-tip":
        law = second._ComputedTorque(second._TABLE_1, 1.5)
    else:
        law = second._Fuzzy(json.loads((second._CONTROLLERS / f"{name.removesuffix('-tip')}.json").read_text()), 1.5)
    policy, rng = load_policy(name, control_period=1e-3), np.random.default_rng(2)
    references, memory = problem_of(TipClaim(name)).schedule.references, None
    box = np.array([1e-4] * 4 + [1e-5] * 2)  # no torque is at its limit
    for k in range(40):
        x = np.concatenate([references[k, :4] + rng.uniform(-1e-4, 1e-4, 4), rng.uniform(-1e-6, 1e-6, 2)])
        memory = np.concatenate([x[4:], np.zeros(policy.memory_size - 2) if memory is None else memory[2:]])
        twin = x + rng.uniform(-box, box)
        other = np.concatenate([twin[4:], memory[2:]])
        moved, _ = policy.predict(np.concatenate([twin[:4], references[k]]), other)
        torque, memory = policy.predict(np.concatenate([x[:4], references[k]]), memory)
        u, slopes, rest, _ = law.respond(k, x.tolist(), box)
        spread = [second._upper(ball - ball.mid()) for ball in u]
        middle = np.array([float(ball.mid()) for ball in u])
        assert (np.abs(torque - middle) <= spread + rest).all()
        assert (np.abs(moved - middle - slopes @ (twin - x)) <= spread + rest).all()
        assert (rest < 0.1).all() and max(spread) < 1e-7


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("name", ["table-1", "near"])
@pytest.mark.parametrize(
    ("policy", "laps"), [(LAWS[0], "ever"), (LAWS[1], "ever"), (LAWS[2], "one"), ("shield:fuzzy-4-tip:any:4,2", "one")]
)
def test_full_motions_are_proven_twice(policy, laps, name, tmp_path):
    save_bound(find_bound(TipClaim(policy, plants=SETS[name], laps=laps)), tmp_path / "bound.json")
    assert second.check(tmp_path / "bound.json").proven


@pytest.mark.parametrize(
    ("policy", "plants"),
    [("computed-torque-tip", PlantSet(dry_friction=(0.0, 0.0))), ("shield:fuzzy-4-tip:any:4,2", SETS["table-1"])],
    ids=["no dry friction", "guest"],
)
def test_bounds_of_other_kinds_are_proven(policy, plants, tmp_path):
    path = tmp_path / "bound.json"
    save_bound(find_bound(TipClaim(policy, plants=plants, steps=6)), path)
    assert second.check(path).proven
    document = json.loads(path.read_text())
    document["policy"] = policy.replace("4,2", "5,2")
    path.write_text(json.dumps(document | {"bound": document["bound"] * (1.0 if ":" in policy else 0.9)}))
    assert second.check(path).verdict == "NOT PROVEN"


@pytest.mark.parametrize("change", ["the same", "a little more", "much more", "another column", "moved", "constants"])
def test_a_set_holds_the_end_of_a_lap_if_linear_programming_says_so(true, change):
    """An end that is inside has for each of its points factors of at most 1, by a solver that knows nothing of it."""
    rng = np.random.default_rng(0)
    with ctx.workprec(second._BITS):
        tube = second._Tube(second._Claim(json.loads(true.read_text())))
        m, columns = len(tube._plant.column), rng.normal(size=(12, 40)) * np.logspace(-6, -3, 12)[:, np.newaxis]
        columns[8:10] = 0.0
        tube._G, tube._tags = np.hstack([tube._G[:, :m], columns]), np.arange(40)
        assert not tube._is_inside()
        held, centre = tube._G[[*range(8), 10, 11]].copy(), np.array([*tube._centre, *tube._memory])
        later = np.hstack([tube._G[:, :m], columns])
        later[:, m:] *= {"a little more": 1.0005, "much more": 1.01}.get(change, 1.0)
        if change == "another column":
            later[:8, m] = rng.normal(size=8) * np.logspace(-6, -3, 12)[:8]
        if change == "constants":
            later[:8, 0] += 1e-2
        tube._centre[2] += 1e-3 if change == "moved" else 0.0
        tube._G, tube._tags = later, np.arange(40)
        shift = np.array([*tube._centre, *tube._memory]) - centre
        inside = tube._is_inside()
    assert inside == (change in ("the same", "a little more"))
    rows, G, free = [*range(8), 10, 11], held[:, m:], held.shape[1] - m
    scale = np.abs(G).sum(axis=1)
    for signs in rng.choice([-1.0, 1.0], (20, 40 + m)) if inside else ():
        point = shift + later[rows] @ np.roll(signs, m) - held[:, :m] @ np.roll(signs, m)[:m]
        found = linprog(np.zeros(free), A_eq=G / scale[:, np.newaxis], b_eq=point / scale, bounds=(-1.0, 1.0))
        assert found.status == 0
