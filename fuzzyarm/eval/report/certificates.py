"""The section of certificates: certified bounds beside the worst observed on the rigid arm, and certificates in words.

Observing a controller file takes a few seconds: the searches and rollouts of ``benchmarks/certified_bounds.py`` with
twice its time step. The section of tubes draws around the path what is proven of the tip of the elastic, sampled arm.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from decimal import Decimal
from html import escape
from pathlib import Path
from typing import Any, cast

import numpy as np

from fuzzyarm.common.arithmetic import at_least, at_most
from fuzzyarm.envs.scenario.reference import Reference
from fuzzyarm.eval.episodes.rollout import Rollout
from fuzzyarm.eval.evaluation.run import Evaluation, EvaluationConfig
from fuzzyarm.eval.report.summary import Axis, figure
from fuzzyarm.fuzzy_policy.controller import Controller
from fuzzyarm.policies.spec import resolve
from fuzzyarm.policies.tip_bound import plain
from fuzzyarm.policies.tip_files import BoundCheck, check_bound
from fuzzyarm.proof import rigid_loop
from fuzzyarm.proof.certificate import NOT_COVERED
from fuzzyarm.proof.policy_certificate import certificate_of
from fuzzyarm.proof.rigid_loop import RigidLoop

__all__ = [
    "Observed", "bound_charts", "certificate_parts", "checked_bounds", "observe", "observe_policies", "tube_section",
]  # fmt: skip


_STEP = 1e-3  # [s] of the rollouts; the fastest time constant of the shipped loops is about 4e-3 s


@dataclasses.dataclass(frozen=True)
class Observed:
    """The worst values that were observed on the rigid arm in continuous time."""

    decay: float  # smallest decay rate -V'/2V of undisturbed rollouts [1/s]
    gain: float  # largest ‖q - q_d‖₂ / ‖w‖₂ of disturbed rollouts from zero error [rad/(N m)]
    probe: str  # name of the disturbance with that largest gain


def observe(loop: RigidLoop, reference: Reference) -> Observed:
    """Return the slowest decay of rollouts, from random states and where V decays slowest, and the largest gain.

    The gain is that under a library of torques and the worst torque found by power iteration, along the reference and
    at the held posture of largest frozen gain.
    """
    gains, duration = list[tuple[float, str]](), reference.duration
    for motion in (reference, rigid_loop.worst_posture(loop)):
        worst = rigid_loop.worst_torque(loop, motion, duration, step=_STEP)
        probes = rigid_loop.library(duration, _STEP) | {"worst torque found": worst}
        run = rigid_loop.disturbed_run(loop, motion, probes, duration, _STEP)
        # The certificate claims nothing outside the box, so gains count only until a rollout leaves it.
        found = np.where(run.in_box, run.gain, 0.0).max(axis=0)
        gains += zip(found.tolist(), probes, strict=True)
    return Observed(rigid_loop.decay_rates(loop, _STEP).observed, *max(gains))


def observe_policies(
    config: EvaluationConfig, bounds: Mapping[str, Mapping[str, Any] | None]
) -> dict[str, Observed | str]:
    """Return the observations of every policy with certified bounds by its name, or in words why there are none."""
    reference = config.reference()
    by_file: dict[str, Observed] = {}  # by the digest of the controller file, which several policies may share
    result: dict[str, Observed | str] = {}
    for spec in map(resolve, config.policies):
        if (claimed := bounds[spec.label]) is None:
            continue
        if claimed["form"] != "consistent":
            result[spec.label] = f"not observed: the bounds of the {claimed['form']} form are of other quantities"
            continue
        try:
            certificate = certificate_of(spec.load(config.control_period, config.parameters), reference)
        except (OSError, ValueError):
            result[spec.label] = "not observed: the controller file is gone or no longer proven"
            continue
        if certificate is None or certificate.bounds != claimed:
            result[spec.label] = "not observed: the controller file has changed since the evaluation"
            continue
        if (digest := claimed["controller_digest"]) not in by_file:
            by_file[digest] = observe(RigidLoop(cast("Controller", certificate.controller)), reference)
        result[spec.label] = by_file[digest]
    return result


_SIZE, _EDGE = 440.0, 26.0  # of the drawing and around it [px]
_WIDEST = 0.12  # share of the path's extent that the widest half of a tube may take
_TUBE_NOTE = (
    "Band: the tip error that is proven at every sample, for every plant of the set, to either side of the path; line "
    "in it: the tip of the replayed episode. Both are magnified around the path. The files were checked again when "
    "this report was made."
)


def checked_bounds(paths: Sequence[Path]) -> list[BoundCheck]:
    """Return the check of each file of a bound; ValueError names the first file that is not proven."""
    found = [check_bound(path) for path in paths]
    for check in found:
        if not check.proven:
            raise ValueError(f"{check.path} is not proven: {check.reason}")
    return found


def tube_section(checks: Sequence[BoundCheck], rollouts: Sequence[Rollout]) -> str:
    """Return the section of proven tubes, empty without bounds; ValueError if a bound has no episode."""
    if not checks:
        return ""
    drawn = "".join(_tube(check, _episode(check, rollouts)) for check in checks)
    sentences = "".join(f"<li>{escape(plain(check.claim.policy))}: {escape(check.sentence)}.</li>" for check in checks)
    return (
        '<section aria-labelledby="tubes"><h2 id="tubes">Proven of the tip</h2>'
        f'<ul>{sentences}</ul><div class="charts">{drawn}</div><p class="note">{escape(_TUBE_NOTE)}</p></section>'
    )


def _episode(check: BoundCheck, rollouts: Sequence[Rollout]) -> Rollout:
    claim = check.claim
    for run in rollouts:
        if (run.policy, run.case) == (claim.policy, claim.case) and len(run.tip) >= len(check.tip):
            wanted = check.reference().tip(run.time[: len(check.tip)]).position
            found = run.tip_reference[: len(check.tip)]
            if found.shape == wanted.shape and np.abs(found - wanted).max() < 1e-9:
                return run
    raise ValueError(
        f"{check.path}: the evaluation has no episode of {claim.policy} in case {claim.case} along the {claim.path} in "
        f"{claim.duration:g} s"
    )


def _tube(check: BoundCheck, run: Rollout) -> str:
    """Return the drawing of one tube, x to the right and y upwards."""
    count = len(check.tip)
    path, tip = run.tip_reference[:count], run.tip[:count]
    along = np.gradient(path, axis=0)
    across = np.stack([-along[:, 1], along[:, 0]], axis=1) / np.maximum(np.hypot(*along.T), 1e-12)[:, np.newaxis]
    extent = float(np.ptp(path, axis=0).max())
    most = _WIDEST * extent / max(float(check.tip.max()), 1e-12)
    power = 10.0 ** math.floor(math.log10(most))
    times = max(step * power for step in (1.0, 2.0, 5.0) if step * power <= most * (1 + 1e-12))
    middle = 0.5 * (path.min(axis=0) + path.max(axis=0))
    scale = (_SIZE - 2.0 * _EDGE) / (extent * (1.0 + 2.0 * _WIDEST))

    def points(places: np.ndarray) -> str:
        pixels = 0.5 * _SIZE + scale * (places - middle) * [1.0, -1.0]
        return " ".join(f"{x:.1f},{y:.1f}" for x, y in pixels)

    half = times * check.tip[:, np.newaxis] * across
    band = np.concatenate([path + half, (path - half)[::-1]])
    title = f"{plain(check.claim.policy)}, set {check.claim.named_set(check.arm)}: errors {times:g} times"
    svg = (
        f'<svg class="chart tube" role="img" viewBox="0 0 {_SIZE:g} {_SIZE:g}"><title>{escape(title)}</title>'
        f'<polygon class="band" points="{points(band)}"/><polyline class="path" points="{points(path)}"/>'
        f'<polyline class="tip" points="{points(path + times * (tip - path))}"/></svg>'
    )
    return figure(title, svg)


_SCOPE = (
    "A certificate is proven for the rigid arm in continuous time, as long as it stays inside the box, and not for the "
    "sampled elastic arm of the replay. " + NOT_COVERED
)
_NOTE = (
    "❘ certified bound; the hatched range is what it rules out. ● and digits: the worst observed on the rigid arm when "
    "this report was made, that is the slowest decay of the Lyapunov function in undisturbed rollouts, and the largest "
    "gain over a library of torques and the worst torque found by power iteration, along the reference and at the "
    "worst held posture. A -tip policy has the bounds of its controller file, which is observed once for both policies."
)

_Observations = Mapping[str, Observed | str]  # by policy; in words why nothing was observed, see `observe_policies`


def certificate_parts(stored: Evaluation, observed: _Observations) -> dict[str, str]:
    """Return the parts of the section by their name in ``page.html``: scope, charts, note below, and certificates."""
    reasons = [f" {name}: {text}." for name, text in observed.items() if isinstance(text, str)]
    return {
        "scope": escape(_SCOPE),
        "bounds": bound_charts(stored, observed),
        "bounds_note": escape(_NOTE + "".join(reasons)),
        "statements": _statements(stored.certificates),
    }


# The charts: title, label of the axis, name of the bound, decimal digits by which the axis's unit is below that of SI,
# and the forms of controllers that claim the bound of the rigid arm's error.
_CHARTS = (
    ("Decay rate", "decay rate of the root of V [1/s]", "alpha", 0, ("consistent", "semidefinite")),
    ("L2 gain, disturbance to error", "L2 gain [µrad/(N m)]", "gamma", 6, ("consistent",)),
)


def bound_charts(stored: Evaluation, observed: _Observations) -> str:
    """Return a chart of each kind of bound; a policy without comparable bounds has a text in its row.

    The decay rate is a lower bound, the gain an upper one.
    """
    charts = []
    for title, label, key, digits, forms in _CHARTS:
        lower, found = key == "alpha", dict[str, tuple[float, float | None] | str]()
        for name, claimed in stored.bounds.items():
            if claimed is None or claimed["form"] not in forms:
                found[name] = "nothing proven" if claimed is None else "of other quantities"
                continue
            seen = observed.get(name)
            worst = 10.0**digits * (seen.decay if lower else seen.gain) if isinstance(seen, Observed) else None
            # Rounded so that it holds before the unit is changed, which is exact in decimal.
            found[name] = float(Decimal((at_least if lower else at_most)(claimed[key], 3)).scaleb(digits)), worst
        values = [value for one in found.values() if not isinstance(one, str) for value in one if value is not None]
        axis = Axis(label, 0.0, 1.25 * max(values, default=1.0))
        rows = [(name, one if isinstance(one, str) else axis.bound(*one, lower=lower)) for name, one in found.items()]
        charts.append(figure(title, axis.chart(rows, f"{title}: certified bound and worst observed")))
    return "".join(charts)


def _statements(certificates: Mapping[str, str | None]) -> str:
    """Return every certificate in words, as a folded paragraph, and the names of the policies without one."""
    parts = [
        f'<details class="note"><summary>{escape(name)}: what is proven</summary><p>{escape(text)}</p></details>'
        for name, text in certificates.items()
        if text is not None
    ]
    if without := ", ".join(name for name, text in certificates.items() if text is None):
        parts.append(f'<p class="note">Nothing is proven of the rigid arm: {escape(without)}.</p>')
    return "".join(parts)
