"""Forged controller files, signed and well formed, so that nothing but the proof can refuse them.

What is called proven has to obey the dissipation inequality of its claim at states of the arm (`support.dissipation`).
"""

from __future__ import annotations

import dataclasses
import functools
import json
import math
import shutil
import warnings
from pathlib import Path

import cvxpy as cp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.dissipation import excess, scheduled_excess
from support.shipped import CONTROLLERS

from fuzzyarm import Controller, DesignProblem, Specification, TSModel, design
from fuzzyarm.cli import main
from fuzzyarm.fuzzy_policy.scheduled_controller import load_controller
from fuzzyarm.fuzzy_policy.signed_files import ControllerFileError
from fuzzyarm.policies.tip_files import check_bound
from fuzzyarm.proof import _theorems as theorems
from fuzzyarm.proof.certificate import Certificate, _inequality_name, certify
from fuzzyarm.proof.scheduled_certificate import certify_scheduled
from fuzzyarm.synthesis._design_problem import _MARGIN as MARGIN
from fuzzyarm.synthesis._designer import to_controller
from fuzzyarm.synthesis._expressions import half

from .judged import examples
from .samples import bounds, of_robot, signed

pytestmark = pytest.mark.slow

BASES = ("fuzzy-1", "fuzzy-2", "fuzzy-4", "paper-1", "paper-2-integral", "paper-4-common")
SLACK = ("P", "Q", "X", "tau", "pole_Q", "pole_X", "pole_tau")
NEAR = st.floats(-0.5, 0.5).map(math.exp)


@functools.cache
def shipped(name: str) -> Controller:
    return Controller.load(CONTROLLERS[name])


def judged(forged: Controller, folder: Path) -> Certificate:
    """Write the file, read it, prove it; what is proven has to hold."""
    forged.save(folder / "forged.json")
    read = load_controller(folder / "forged.json")
    assert isinstance(read, Controller)
    certificate = certify(read)
    if certificate.proven:
        assert excess(read) < 0.0, f"PROVEN, but V' + z'z - γ²w'w + 2αV reaches {excess(read):.3g} V"
    return certificate


@pytest.mark.parametrize("name", BASES)
def test_the_true_twins_are_proven_and_hold_without_much_room(name, tmp_path):
    """And the oracle is no formality: with 1.1 times the rate or 0.7 times the gain it says no."""
    assert judged(shipped(name), tmp_path).proven
    for field, factor in (("alpha", 1.1), ("gamma", 0.7)):
        assert excess(dataclasses.replace(shipped(name), **{field: factor * getattr(shipped(name), field)})) > 0.0


def other_arm(controller: Controller, **factors: float) -> Controller:
    """Return the controller as one for an arm with other constants; the file's bounds are that arm's."""
    arm = controller.model.parameters
    values = {name: tuple(x * factor for x in getattr(arm, name)) for name, factor in factors.items()}
    return dataclasses.replace(controller, model=TSModel(dataclasses.replace(arm, **values), controller.model.kept))


FORGERIES = {
    "a faster decay": lambda c: dataclasses.replace(c, alpha=1.2 * c.alpha),
    "a smaller gain": lambda c: dataclasses.replace(c, gamma=0.5 * c.gamma),
    "the square root of the gain": lambda c: dataclasses.replace(c, gamma=c.gamma**2),
    "a heavier arm": lambda c: other_arm(c, mass=2.0, inertia=2.0),
    "larger motors": lambda c: other_arm(c, motor_inertia=3.0),
    "weaker gains": lambda c: dataclasses.replace(c, gains=0.5 * c.gains),
    "gains of the wrong sign": lambda c: dataclasses.replace(c, gains=-c.gains),
    "P turned over": lambda c: dataclasses.replace(c, P=-c.P),
    "another P": lambda c: dataclasses.replace(c, P=np.diag(np.diag(c.P))),
}


@pytest.mark.parametrize("name", ["fuzzy-1", "fuzzy-4", "paper-1", "paper-4-common"])
@pytest.mark.parametrize("forgery", list(FORGERIES))
def test_a_claim_that_is_false_is_not_proven(name, forgery, tmp_path, capsys):
    forged = FORGERIES[forgery](shipped(name))
    false = excess(forged) > 0.0
    assert false or forgery == "the square root of the gain"  # of the paper's form it is larger
    assert not (judged(forged, tmp_path).proven and false)
    if name == "fuzzy-1":
        assert main(["verify", str(tmp_path / "forged.json")]) == 1
        assert "NOT PROVEN" in capsys.readouterr().out


@examples(150)
@given(data=st.data(), name=st.sampled_from(BASES))
def test_whatever_is_forged_is_true_or_not_proven(data, name, tmp_path_factory):
    """Claims, gains, arm and slack are scaled or pushed, one to three of them; some stay true, most do not."""
    forged = shipped(name)
    parts = st.sampled_from(["claim", "claim", "gains", "arm", "slack", "entry"])
    constants = st.sampled_from(["mass", "inertia", "motor_inertia", "viscous_friction", "velocity_limit"])
    claims = ["alpha", "gamma", *["fastest_pole"] * (forged.fastest_pole is not None)]
    for what in data.draw(st.lists(parts, min_size=1, max_size=3)):
        factor = data.draw(NEAR)
        if what in ("claim", "gains"):
            field = "gains" if what == "gains" else data.draw(st.sampled_from(claims))
            forged = dataclasses.replace(forged, **{field: getattr(forged, field) * factor})
        elif what == "arm":
            forged = other_arm(forged, **{data.draw(constants): factor})
        else:
            field = data.draw(st.sampled_from([one for one in SLACK if getattr(forged, one) is not None]))
            array = np.array(getattr(forged, field))
            if what == "slack" or not array.size:
                array = array * factor
            else:
                array.flat[data.draw(st.integers(0, array.size - 1))] *= data.draw(st.sampled_from([0.0, -1.0, factor]))
                array = 0.5 * (array + array.T) if field == "P" else array
            try:
                forged = dataclasses.replace(forged, **{field: array})
            except ControllerFileError:
                return  # P is no longer of blocks
    judged(forged, tmp_path_factory.mktemp("forged"))


@pytest.mark.parametrize("kept", [(), ("z1",), ("z3",)])
@pytest.mark.parametrize("asked", [{"gamma": 2e-4}, {"gamma": None, "gain_bound": 2e5}], ids=["alpha", "gamma"])
def test_designs_at_the_end_of_what_can_be_proven_hold(kept, asked):
    """A term that design and proof both lack would show here: the oracle lacks none."""
    given = Specification(kept=kept, **asked)
    assert excess(design(given).controller, 2000) < 0.0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert excess(DesignProblem(given).solve().controller, 2000) < 0.0  # whose inequalities are those of the proof


# Files that lack a single inequality: a solver is asked for all of the others.


@pytest.mark.parametrize(
    ("kept", "name"),
    [
        ((), "P > 0"),
        ((), "Psi_1,1,1 < 0"),
        (("z1",), "Psi_1,1,2 < 0"),
        (("z3",), "P > 0"),
        (("z3",), "Psi_1,1,1 < 0"),
        (("z3",), "Psi_1,2,1 + Psi_2,1,1 < 0"),
    ],
)
def test_each_inequality_is_needed(kept, name, tmp_path):
    """A solver is asked for all matrices but one, with the full slack, that is <= 10 I and not <= 0."""
    asked = Specification(kept=kept, gamma=1e-3)
    problem, generator = DesignProblem(asked), np.random.default_rng(3)
    data, unit, row = problem._data, problem._units, problem._row_units("Psi")
    n, m, vertices = data.n_e, len(data.uncertainties), (len(data.A), len(data.E))
    P, M = cp.Variable((n, n), symmetric=True), cp.Variable((*vertices, 2, n))
    rows = [cp.norm(M[j, k], "fro") <= 1e3 for j, k in np.ndindex(vertices)]
    rows.append(P << -np.eye(n) if name == "P > 0" else P >> np.eye(n))
    aim, slack, multipliers = cp.Constant(0.0), [], []
    for i, j in data.pairs:
        Q, X = cp.Variable((n, n)), cp.Variable((n, n))
        slack.append((Q, X))
        for k in range(vertices[1]):
            tau = cp.Variable(m)
            multipliers.append(tau)

            def matrix(a, b, k=k, Q=Q, X=X, tau=tau):
                half_of = theorems.error_psi(
                    data, a, k, alpha=asked.alpha, gamma2=problem._c * asked.gamma**2, output=problem._c**0.5,
                    P=cp.multiply(unit["P"], P), M=cp.multiply(unit["M"], M[b, k]), Q=cp.multiply(unit["Q"], Q),
                    X=cp.multiply(unit["X"], X), tau=cp.multiply(unit["tau"], tau), put=half,
                )  # fmt: skip
                return cp.multiply(np.outer(row, row), half_of + half_of.T)

            parts = [matrix(i, j), matrix(j, i)]
            if _inequality_name("Psi", i, j, k) != name:
                rows.append(0.5 * (parts[0] + parts[1]) << -MARGIN * np.eye(len(row)))
                continue
            rows += [part << 10.0 * np.eye(len(row)) for part in parts]
            if i != j:  # half of it holds
                rows.append(parts[0] << -1e-3 * np.eye(len(row)))
            across = generator.normal(size=len(row))
            aim = across @ (parts[0] + parts[1]) @ across
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that it may be inaccurate: the proof decides
        cp.Problem(cp.Maximize(aim), rows).solve(solver="CLARABEL", canon_backend="SCIPY")
    c = problem._c
    Q, X = (c * unit[letter] * np.array([pair[at].value for pair in slack]) for at, letter in enumerate("QX"))
    tau = c * unit["tau"] * np.array([one.value for one in multipliers])
    point = dataclasses.replace(
        problem.point(), P=c * unit["P"] * P.value, M=c * unit["M"] * M.value,
        slack=((Q, X, tau.reshape(len(data.pairs), -1, m)),),
    )  # fmt: skip
    certificate = judged(to_controller(problem.model, asked, point, "forged"), tmp_path)
    assert [claim.name for claim in certificate.claims if not claim.proven] == [name]


# What the reader refuses, although the digest is right.


@pytest.mark.parametrize(
    ("name", "change", "said"),
    [
        ("paper-1", lambda d: [d["P"][a].__setitem__(b, "0x1p-40") for a, b in ((0, 6), (6, 0))], "block diagonal"),
        ("fuzzy-1", lambda d: d["P"][0].__setitem__(1, "0x1p-40"), "symmetric"),
        ("paper-1", lambda d: d["weight"].__setitem__(0, "0x0p+0"), "weight = "),
        ("fuzzy-1", lambda d: d.update(gamma=(-2e-4).hex()), "gamma = "),
        ("fuzzy-4", lambda d: d.update(fastest_pole=(19.0).hex()), "fastest_pole = "),
        ("fuzzy-1", lambda d: d.update(alpha="0x1p+99999"), "exceeds the largest float"),
        ("fuzzy-1", lambda d: d["tau"].pop(), "tau"),
        ("fuzzy-1", lambda d: d.update(common_multiplier=True), "tau"),
    ],
)  # fmt: skip
def test_a_signed_file_that_fits_together_badly_is_refused_in_one_line(name, change, said, tmp_path):
    document = json.loads(shipped(name).to_json())
    change(document)
    (tmp_path / "forged.json").write_text(json.dumps(signed(document)))
    with pytest.raises(ControllerFileError, match=said) as caught:
        load_controller(tmp_path / "forged.json")
    assert "\n" not in str(caught.value)


def test_a_cell_that_is_not_confirmed_leaves_the_whole_unproven(tmp_path):
    """A cell's tube is half as wide as it is; the other cell, what both cover and the claimed bound stay."""
    folder = tmp_path / "bounds"
    shutil.copytree(bounds(), folder)
    assert check_bound(folder / "cells.json").proven
    cell = json.loads((folder / "cells-001.json").read_text())
    cell["steps"][-1][-1]["tube"] = [0.5 * radius for radius in cell["steps"][-1][-1]["tube"]]
    (folder / "cells-001.json").write_text(json.dumps(cell))
    found = check_bound(folder / "cells.json")
    assert not found.proven and found.reason.startswith("cells-001.json: ") and "leave the claimed tube" in found.reason


# Controllers of robots.


def test_the_true_twin_of_a_robot_is_proven_and_holds():
    assert certify_scheduled(of_robot()).proven
    assert scheduled_excess(of_robot()) < 0.0


@examples(40)
@given(data=st.data())
def test_whatever_is_forged_for_a_robot_is_true_or_not_proven(data):
    fields = ("alpha", "gamma", "kappa", "rates", "feedback", "inertia", "fastest_pole", "floor", "lyapunov")
    forged = of_robot()
    for field in data.draw(st.lists(st.sampled_from(fields), min_size=1, max_size=2, unique=True)):
        factor = data.draw(st.one_of(NEAR, st.sampled_from([0.0, 1.05, 0.95]) if field == "rates" else NEAR))
        try:
            forged = dataclasses.replace(forged, **{field: factor * getattr(forged, field)})
        except ControllerFileError:
            return
    if certify_scheduled(forged).proven:
        assert scheduled_excess(forged) < 0.0
