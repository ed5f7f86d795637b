"""Design every shipped controller file again.

python benchmarks/shipped_controllers.py [FOLDER]

The consistent form with integral for 32 to 1 rules (alpha = 20, smallest gains; gamma and the fastest pole as chosen by
`gain_choice.py`, with z1 kept and with z1 dropped), and witnesses of the paper's own form (Theorem 2; Theorem 1 for
32 rules) at alpha = 20, gamma = 1000 and the paper's Q: for 4, 2 and 1 rules with and without integral, with one
multiplier for all dropped premises of A as printed and with one for each; and one whose gains exceed 1e9, see
`raise_gains`. The slack of that with 32 rules is rounded, see `with_short_slack`. `fuzzy-4-sampled` has the gains of
`fuzzy-4` times the factors that `tip_gains.py` found on the sampled elastic arm, and a proof of its own. Each file is
proven before it is written. A minute.
"""

from __future__ import annotations

import dataclasses
import itertools
import sys
from pathlib import Path

import cvxpy as cp
import numpy as np

import fuzzyarm
from fuzzyarm.fuzzy_policy.controller import Controller
from fuzzyarm.fuzzy_policy.ts_model import NAMED_RULES, POSITION, PREMISES, VELOCITY
from fuzzyarm.proof.certificate import certify
from fuzzyarm.synthesis import DesignFailed, DesignProblem, Specification, design

GAMMA = {True: 1.4e-4, False: 2e-4}  # rad/(N m), by whether z1 is kept
FASTEST_POLE = {True: 200.0, False: None}  # 1/s
SAMPLED = np.array([[0.96, 1.21], [1.19, 0.9], [0.85, 1.15]])
"""Factors on the gains of `fuzzy-4` on angle, velocity and integral of each joint, as `tip_gains.py` finds them."""
SAMPLED_GAMMA = 2e-4  # rad/(N m)


def specifications() -> dict[str, Specification]:
    """Return the specification of each file by its name."""
    result = {
        f"fuzzy-{rules}": Specification(kept, gamma=GAMMA["z1" in kept], fastest_pole=FASTEST_POLE["z1" in kept])
        for rules, kept in NAMED_RULES.items()
    }
    for rules, integral, common in itertools.product((4, 2, 1), (False, True), (False, True)):
        name = f"paper-{rules}" + "-integral" * integral + "-common" * common
        result[name] = Specification(
            NAMED_RULES[rules], "paper", gamma=1000.0, integral=integral, common_multiplier=common
        )
    result["paper-32-integral"] = Specification(PREMISES, "paper", gamma=1000.0)
    return result


def with_short_slack(controller: Controller, bits: int = 13) -> Controller:
    """Return a controller whose Q and X have so few bits, with the same gains and P; the file compresses to half."""

    def short(values: np.ndarray) -> np.ndarray:
        mantissa, exponent = np.frexp(values)
        return np.ldexp(np.round(np.ldexp(mantissa, bits)), exponent - bits)

    origin = {**controller.origin, "Q, X": f"rounded to {bits} bits"}
    return dataclasses.replace(controller, Q=short(controller.Q), X=short(controller.X), origin=origin)


def raise_gains(controller: Controller, target: float) -> Controller:
    """Return a controller with a position gain of `target` [N m/rad] that the same theorem proves.

    With S the columns of q̇ of the identity, M' = M - ρ Sᵀ, X' = X + ρ S Sᵀ, Q' = Q - ρ z S Sᵀ adds to every Ψ, in the
    rows S of e and ė, ρ times [[-2z, z E], [z E, -2E]], which is negative semidefinite for z E <= 4: no
    inequality limits the gains, whatever ρ. (z1 must be kept, so that E is certain.)
    """
    n_e, n = controller.gains.shape[-1], len(controller.P)
    S = np.eye(n)[:, VELOCITY]
    largest = max(np.linalg.eigvalsh(E[VELOCITY, VELOCITY])[-1] for E in controller.model.E_vertices)
    inverse = np.linalg.inv(controller.P[:n_e, :n_e])
    rho = target / np.abs(inverse[VELOCITY, POSITION]).max()
    return dataclasses.replace(
        controller,
        gains=controller.gains - rho * S[:n_e].T @ inverse,
        X=controller.X + rho * S @ S.T,
        Q=controller.Q - rho / largest * S @ S.T,
        origin={**controller.origin, "objective": f"gains raised until a position gain exceeds {target:g} N m/rad"},
    )


def with_factors(controller: Controller, factors: np.ndarray) -> Controller:
    """Return a controller with factors (3, 2) on its gains on angle, velocity and integral; its proof does not hold."""
    return dataclasses.replace(controller, gains=controller.gains * np.concatenate([*factors]))


def proven_at_its_gains(controller: Controller, gamma: float) -> Controller | None:
    """Return a controller with the same gains and decay rate, and a proof; None if none is found.

    The L2 gain is gamma [rad/(N m)]. With the gains given, M = K P11 makes the conditions linear in P and the slack.
    """
    asked = Specification(controller.model.kept, alpha=controller.alpha, gamma=gamma)
    problem = DesignProblem(asked, controller.model.parameters)
    P11 = problem.P[: controller.gains.shape[-1], : controller.gains.shape[-1]]
    size = np.abs(controller.gains).max(axis=-1, keepdims=True)
    scaled = cp.multiply(np.broadcast_to(1.0 / size, controller.gains.shape), problem.M)
    problem.constraints.append(scaled == (controller.gains / size) @ P11)
    try:
        found = problem.solve().controller
    except DesignFailed:
        return None
    origin = {**found.origin, "objective": "gains found on the sampled elastic arm, with a proof at these gains"}
    exact = dataclasses.replace(found, gains=controller.gains, origin=origin)
    return exact if certify(exact).proven else None


def main() -> None:
    """Design, prove and write."""
    package = Path(fuzzyarm.__file__).parent
    folder, papers = package / "fuzzy_policy" / "controllers", package / "eval" / "paper" / "controllers"
    if len(sys.argv) > 1:
        folder = papers = Path(sys.argv[1])
    for name, specification in specifications().items():
        made = design(specification)
        controller = with_short_slack(made.controller) if name == "paper-32-integral" else made.controller
        if not certify(controller).proven:
            raise SystemExit(f"{name} is not proven")
        controller.save((papers if name.startswith("paper") else folder) / f"{name}.json")
        print(f"{name:24} solved in {made.solve_seconds:6.2f} s, proven in {made.proof_seconds:5.2f} s", flush=True)
    raised = raise_gains(Controller.load(papers / "paper-4-common.json"), 2e9)
    if not certify(raised).proven:
        raise SystemExit("the controller with raised gains is not proven")
    raised.save(papers / "paper-4-common-high-gain.json")
    sampled = proven_at_its_gains(with_factors(Controller.load(folder / "fuzzy-4.json"), SAMPLED), SAMPLED_GAMMA)
    if sampled is None:
        raise SystemExit("fuzzy-4-sampled is not proven")
    sampled.save(folder / "fuzzy-4-sampled.json")


if __name__ == "__main__":
    main()
