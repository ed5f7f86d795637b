"""The tube against the arm: no simulated plant of the set leaves it, and it is checked again from its file."""

import dataclasses
import functools
import itertools
import json

import numpy as np
import pytest
from slow_twins import slow_but
from support.command_line import one_line_error

from fuzzyarm import load_policy
from fuzzyarm.cli import main
from fuzzyarm.envs.physics.dynamics import Payload
from fuzzyarm.envs.physics.event_integrator import integrate
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.policies.tip_bound import TipClaim, arm_in_words, find_bound, plain, problem_of
from fuzzyarm.policies.tip_files import check_bound, save_bound
from fuzzyarm.proof.tip.centre import Mode
from fuzzyarm.proof.tip.friction import Plan
from fuzzyarm.proof.tip.period import Period
from fuzzyarm.proof.tip.plant import PlantSet
from fuzzyarm.proof.tip.transition import ROWS, STATES
from fuzzyarm.proof.tip.tube import Tube

STEPS = 24
ROUNDING = 1e-15  # of a tip that is computed in floats [m]
SMALL = PlantSet(stiffness=(0.99, 1.01), mass=(0.998, 1.002), damping=(0.9, 1.1), motor_inertia=(0.995, 1.005))


def claim(plants=None, policy="fuzzy-4-tip", steps=STEPS, case="nominal"):
    return TipClaim(policy, case, "table-1" if plants is None else "own", plants or PlantSet(), steps=steps)


@functools.cache
def setting_of(of):
    """The schedule, the first state and the policy of a claim; the policy is proven each time that it is loaded."""
    problem = problem_of(of)
    return problem.schedule, problem.start, load_policy(of.policy)


@pytest.fixture(scope="module")
def exact():
    return find_bound(claim())


def simulated(of, parameters, payload=None, late=0):
    """Return the states and tip errors at every sample, by the event integrator."""
    table, start, policy = setting_of(of)
    state, memory, waiting, errors, states = start, None, None, [], [start]
    for k in range(table.steps):
        seen = np.concatenate([state[:2], state[4:6], table.references[k]])
        asked, memory = policy.predict(seen, memory)
        acting = asked if waiting is None else waiting
        waiting = asked if late else None
        mean, change = table.forces[k, :2], table.forces[k, 2:]

        def force(t, mean=mean, change=change):
            return mean + (t / 1e-3 - 0.5) * change

        state = integrate(state, acting, force, parameters, payload or Payload(), 0.0, 1e-3)
        tip = tip_of(state[2:4])
        errors.append(float(np.hypot(*(tip - table.targets[k + 1][:2]))))
        states.append(state.copy())
    return np.array(states), np.array(errors)


def tip_of(q):
    return 0.5 * np.array([np.cos(q[0]) + np.cos(q.sum()), np.sin(q[0]) + np.sin(q.sum())])


def test_the_exact_plant_is_in_the_tube_and_the_tube_is_narrow(exact):
    states, errors = simulated(exact.claim, ArmParameters())
    assert (errors <= exact.tip + ROUNDING).all()
    assert exact.tip.max() < 1.1 * errors.max()  # 0.26 µm at this part of the circle
    for state, step in zip(states[1:], exact.steps, strict=True):
        deviation = np.abs(state - step.segments[-1].end)
        assert (deviation <= step.closed[-1].tube[:8] + 1e-12).all()


def test_sticking_and_slipping_are_in_the_tube(exact):
    """The first samples make the motors rest, break away and rest again, also within a period."""
    modes = {mode for step in exact.steps for segment in step.segments for mode in segment.modes}
    assert Mode.REST in modes and len(modes) > 1
    assert max(len(step.segments) for step in exact.steps) > 1
    assert sum(segment.duration for segment in exact.steps[2].segments) == 1e-3


@pytest.mark.parametrize("late", slow_but([1], [0, 1]))
def test_corners_of_a_set_are_in_the_tube(late):
    bound = find_bound(claim(dataclasses.replace(SMALL, late=late), steps=15))
    rng, nominal, largest = np.random.default_rng(3), ArmParameters(), 0.0
    for _ in range(4):
        factors = {
            name: tuple(rng.choice(getattr(SMALL, name), 2))
            for name in ("stiffness", "mass", "damping", "motor_inertia")
        }
        values = {name: tuple(np.multiply(getattr(nominal, name), f)) for name, f in factors.items()}
        values["inertia"] = tuple(np.multiply(nominal.inertia, factors["mass"]))
        states, errors = simulated(bound.claim, dataclasses.replace(nominal, **values), late=late)
        assert (errors <= bound.tip + ROUNDING).all()
        largest = max(largest, float((errors / bound.tip).max()))
        for state, step in zip(states[1:], bound.steps, strict=True):
            assert (np.abs(state - step.segments[-1].end) <= step.closed[-1].tube[:8] + 1e-12).all()
    assert largest > 0.1


def test_the_column_of_a_constant_holds_what_its_corners_do_where_a_velocity_is_bounded_by_itself():
    """δ - C π is within all that is not C for π = ±1, also where motors begin to move (`Plan.MONOTONE`)."""
    plants = PlantSet(viscous_friction=(0.9, 1.1))
    tube, plans = Tube(problem_of(claim(plants, steps=6))), set()
    corners = [
        dataclasses.replace(ArmParameters(), viscous_friction=tuple(f * x for x in ArmParameters().viscous_friction))
        for f in (0.9, 1.1)
    ]
    runs = [simulated(claim(plants, steps=6), arm)[0] for arm in corners]
    for k, step in enumerate(tube, 1):
        plans |= {plan for closed in step.closed for plan in closed.plans}
        own = tube._set.columns[:STATES, :2].sum(axis=1)
        others = np.abs(tube._set.columns[:STATES, 2:]).sum(axis=1) + tube._set.box[:STATES]
        for sign, states in zip((-1.0, 1.0), runs, strict=True):
            assert (np.abs(states[k] - step.segments[-1].end - sign * own) <= others + 1e-12).all()
    assert Plan.MONOTONE in plans


def test_uncertain_constants_act_on_a_motor_whose_velocity_is_bounded_by_itself(monkeypatch):
    """A file may choose the plan MONOTONE where the search gives it up: the inertia's own torque counts there, too."""
    monkeypatch.setattr(Period, "_check_monotone", lambda *_: None)
    plants = PlantSet(motor_inertia=(0.5, 1.5), dry_friction=(0.0, 0.0))
    (step,) = find_bound(claim(plants, policy="computed-torque-tip", steps=1)).steps
    assert [closed.plans for closed in step.closed] == [(Plan.MONOTONE, Plan.MONOTONE)]
    table, speeds = ArmParameters(), slice(4, 6)
    light = tuple(0.5 * x for x in table.motor_inertia)
    arm = dataclasses.replace(table, motor_inertia=light, static_friction=(0.0, 0.0), coulomb_friction=(0.0, 0.0))
    states, _ = simulated(claim(plants, policy="computed-torque-tip", steps=1), arm)
    mean = (states[1] - step.segments[0].end)[speeds] / 1e-3  # of the deviation, both start at rest
    assert (np.abs(mean) <= step.closed[0].tube[ROWS.motor_acceleration]).all()


def test_any_friction_has_a_wider_tube(exact):
    wide = find_bound(claim(PlantSet(friction="any"), steps=12))
    assert (wide.tip >= exact.tip[:12]).all() and wide.tip[-1] > 10.0 * exact.tip[11]


def pushed(of, course, noise=(0.0, 0.0), seed=0):
    """Return the tip errors of the exact plant under a tip force and encoder errors that switch at random."""
    (table, state, policy), rng, memory, errors = setting_of(of), np.random.default_rng(seed), None, []
    side = rng.choice([-1.0, 1.0], 2)
    for k in range(table.steps):
        side = np.where(rng.uniform(size=2) < 0.2, -side, side)
        measured = state[[0, 1, 4, 5]] + np.repeat(noise, 2) * rng.choice([-1.0, 1.0], 4)
        asked, memory = policy.predict(np.concatenate([measured, table.references[k]]), memory)
        mean, change = table.forces[k, :2], table.forces[k, 2:]
        share, force = (side * course, 0.0) if of.case == "nominal" else (0.0, side[0] * of.plants.force_swing)

        def pull(t, m=mean, c=change, add=share, factor=force):
            return (1.0 + factor) * (m + (t / 1e-3 - 0.5) * c) + add

        state = integrate(state, asked, pull, ArmParameters(), Payload(), 0.0, 1e-3)
        errors.append(float(np.hypot(*(tip_of(state[2:4]) - table.targets[k + 1][:2]))))
    return np.array(errors)


def test_a_force_of_any_course_is_in_the_tube_and_fills_it():
    """Both kinds: beside the case's force, and as a factor of it. A bound without it would be a thousandth."""
    for plants, case, least in (
        (PlantSet(force_course=3.0), "nominal", 0.2),
        (PlantSet(force_swing=0.1), "machining", 0.5),
    ):
        bound = find_bound(claim(plants, steps=15, case=case))
        ratios = [pushed(bound.claim, plants.force_course, seed=seed) / bound.tip for seed in range(3)]
        assert np.max(ratios) <= 1.0 and np.max(ratios) > least


def test_errors_of_the_encoders_are_in_the_tube_and_fill_it():
    noise = (1e-5, 1e-3)
    bound = find_bound(claim(PlantSet(noise=noise), steps=15))
    ratios = [pushed(bound.claim, 0.0, noise, seed) / bound.tip for seed in range(2)]
    assert np.max(ratios) <= 1.0 and np.max(ratios) > 0.1


def test_the_file_is_checked_again(exact, tmp_path, capsys):
    path = tmp_path / "bound.json"
    save_bound(exact, path)
    found = check_bound(path)
    assert found.proven and found.bound == exact.largest
    assert sum(exact.spent().values()) == pytest.approx(exact.largest, rel=0.1)
    assert main(["verify", str(path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)[0]["proven"] is True


def test_the_words_are_made_from_the_numbers(tmp_path, capsys):
    """No label of a set is repeated, no name of a set for another arm, no letter that looks like another one."""
    path = tmp_path / "bound.json"
    save_bound(find_bound(claim(steps=2)), path)
    path.write_text(json.dumps(json.loads(path.read_text()) | {"set_name": "near, and stiffness ± 10 %"}))
    assert main(["verify", str(path)]) == 0
    said = capsys.readouterr().out
    assert "for set table-1, proven (elastic arm, the arm of Table 1; sampled control;" in said and "10 %" not in said
    other, own = ArmParameters(mass=(12.0, 9.0)), PlantSet(stiffness=(0.99, 1.01), late=1)
    assert TipClaim("it").named_set(other) == "of one plant"
    assert arm_in_words(other) == "an arm with mass = (12.0, 9.0) kg instead of Table 1's"
    assert "stiffness 2 from 0.99 to 1.01 times, torques 1 control" in TipClaim("it", plants=own).named_set(other)
    assert plain("fuzz\u0443-4") == "fuzz\\u0443-4"


def test_files_that_are_none(exact, tmp_path, capsys):
    path = tmp_path / "bound.json"
    save_bound(exact, path)
    content = json.loads(path.read_text())
    for name, value in (
        ("policy", "fuzzy-99"),
        ("path", "square"),
        ("plants", {"mass": [1.0]}),
        ("files", {"a": "b"}),
        ("set_name", "near"),
        ("bound", 1e300),
        ("tip", [1e300] * STEPS),
        ("duration", 1e300),
        ("plants", {"noise": [1e300, 0.0]}),
        ("steps", [[content["steps"][0][0] | {"duration": 1e300}]]),
        ("steps", [[content["steps"][0][0] | {"duration": 5e-324}]]),
    ):
        path.write_text(json.dumps(content | {name: value}))
        assert main(["verify", str(path)]) == 2
        one_line_error(capsys)


def test_no_bound_is_exit_code_1_and_bad_sets_and_names_are_2(tmp_path, capsys):
    assert main(["prove", "--policy", "adaptive-observer"]) == 1
    assert "no bound for" in one_line_error(capsys)
    wide = tmp_path / "wide.toml"
    wide.write_text("stiffness = [0.5, 1.5]\n")
    assert main(["prove", "--set", str(wide), "--steps", "60", "--json"]) == 1
    answer = json.loads(capsys.readouterr().out)
    assert answer["proven"] is False and answer["bound"] is None and "no bound beyond t" in answer["reason"]
    for text in ("stiffness = [1.1, 0.9]", "stifness = [1.0, 1.0]", "friction = 'none'", "late = 3", "mass = ["):
        wide.write_text(text + "\n")
        assert main(["prove", "--set", str(wide)]) == 2
        assert str(wide) in one_line_error(capsys)
    for words in (["--set", "table-2"], ["--policy", "fuzzy-99"], ["--case", "windy"], ["--steps", "0"]):
        assert main(["prove", *words]) == 2
        one_line_error(capsys)
    for change in (
        {"set_name": "n\u0435ar"},
        {"set_name": "near"},
        {"path": "square"},
        {"plants": {}},
        {"steps": 1501},
    ):
        with pytest.raises((TypeError, ValueError), match=f"^{next(iter(change))}"):
            TipClaim("fuzzy-4-tip", **change)


def test_cells_cover_the_range_and_the_largest_counts(tmp_path, capsys):
    path = tmp_path / "set.toml"
    path.write_text("payload = [0.0, 0.3]\n")
    words = ["prove", "--set", str(path), "--steps", "4", "--json"]
    assert main([*words, "--cells", "payload", "3"]) == 0
    found = json.loads(capsys.readouterr().out)
    ends = [cell["payload"] for cell in found["cells"]]
    assert ends[0][0] == 0.0 and ends[-1][1] == 0.3 and all(a[1] == b[0] for a, b in itertools.pairwise(ends))
    assert found["bound"] == max(cell["bound"] for cell in found["cells"])
    assert main(words) == 0
    assert json.loads(capsys.readouterr().out)["bound"] > 0.9 * found["bound"]
    assert main([*words, "--cells", "friction", "3"]) == 2
    assert "choose from: mass," in one_line_error(capsys)
    assert main([*words, "--cells", "payload", "3", "--cells", "payload", "2"]) == 2
    assert "different names" in one_line_error(capsys)


def test_the_file_of_cells_is_checked_with_every_cell(tmp_path, capsys):
    wanted, out = tmp_path / "set.toml", tmp_path / "loads.json"
    wanted.write_text("payload = [0.0, 0.2]\n")
    words = ["prove", "--set", str(wanted), "--steps", "2", "--cells", "payload", "2", "--out", str(out)]
    assert main(words) == 0
    assert {path.name for path in tmp_path.glob("*.json")} == {"loads.json", "loads-001.json", "loads-002.json"}
    assert "at the first 2 of 1500 samples of the circle in 1.5 s, case nominal, from rest" in capsys.readouterr().out
    assert main(["verify", str(out), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)[0]["cells"] == 2
    assert "set with payload from 0.1 to 0.2 kg, proven" in check_bound(tmp_path / "loads-002.json").sentence
    sound = json.loads(out.read_text())
    first, second = sound["cells"]
    for change, why in (
        ({"cells": [second]}, "no cell holds payload from 0 to 0.1"),
        ({"cells": [first]}, "no cell holds payload from 0.1 to 0.2"),
        ({"bound": 0.5 * sound["bound"]}, "the tip may err"),
        ({"case": "payload"}, "something else"),
        ({"samples": 5}, "something else"),
    ):
        out.write_text(json.dumps(sound | change))
        assert main(["verify", str(out), "--json"]) == 1
        (found,) = json.loads(capsys.readouterr().out)
        assert not found["proven"] and why in found["reason"]
    out.write_text(json.dumps(sound | {"cells": ["../loads-001.json"]}))
    assert main(["verify", str(out)]) == 2
    assert "same folder" in one_line_error(capsys)


@pytest.mark.slow
def test_the_whole_circle():
    for policy, most in (("fuzzy-4-tip", 2.4e-6), ("fuzzy-4", 3.95e-3)):
        assert find_bound(claim(policy=policy, steps=None)).largest < most
