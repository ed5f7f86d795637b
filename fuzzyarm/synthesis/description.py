"""What came out of a design, in words."""

from __future__ import annotations

from fuzzyarm.common.rounding import at_least, at_most
from fuzzyarm.envs.observation import JOINTS
from fuzzyarm.synthesis.designer import Design

__all__ = ["describe"]


def describe(result: Design) -> str:
    """Return what was solved and what came out, for a person."""
    controller, certificate = result.controller, result.certificate
    model = controller.model
    kept, dropped = ", ".join(model.kept) or "none", ", ".join(u.premise for u in model.uncertainties) or "none"
    multipliers = "one multiplier for all of A" if controller.common_multiplier else "one multiplier each"
    pole = "" if controller.fastest_pole is None else f"fastest pole {at_most(controller.fastest_pole, 6)} 1/s, "
    names = ["K q1", "K q2", "K dq1", "K dq2"] + (["H q1", "H q2"] if controller.integral else [])
    lines = [
        f"{model.rules} rules: kept {kept}; as uncertainty: {dropped}, {multipliers}; {controller.form} form, "
        f"{'with' if controller.integral else 'without'} integral",
        f"alpha = {at_least(controller.alpha, 6)} 1/s, gamma = {at_most(controller.gamma, 4)}, {pole}"
        f"{controller.origin['objective']}; {result.variables} variables, {result.rows} cone rows, solved in "
        f"{result.solve_seconds:.2f} s",
        f"all {len(certificate.claims)} inequalities proven in exact rational arithmetic from the stored gains in "
        f"{result.proof_seconds:.2f} s, smallest margin {certificate.proof_margin:.2g}",
        "",
        "gains [N m/rad, N m s/rad, N m/(rad s)]:",
        "vertex  torque " + "".join(f"{name:>13}" for name in names),
    ]
    for i, per_k in enumerate(controller.gains):
        for k, gain in enumerate(per_k):
            for joint in range(JOINTS):
                head = f"i={i + 1} k={k + 1}   {joint + 1}     " if joint == 0 else f"           {joint + 1}     "
                lines.append(head + "".join(f" {value:12.1f}" for value in gain[joint]))
    return "\n".join([*lines, "", certificate.statement])
