"""The score of a policy on a held-out set, used to rank policies in a challenge.

Each episode follows a held-out path, on an arm with random masses, springs and friction, under one of four loads. With
the tip error d in each millisecond, until the reference ends,

    S = mean of 1 - ln(1 + d/s)/ln(1 + R/s),   s = 10 µm, R = 0.2 m, 0 where d > R and after an early end,
    N = 100 (S - S_c) / (S_o - S_c),

with S_c of computed-torque and S_o of learned-observer on the same set: a law that knows only the arm's equations
scores 0, and an observer that learned to estimate its load scores 100. The set is drawn from the name of the version:
it is public, the same for everyone, and new with each version.
"""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from fuzzyarm import __version__
from fuzzyarm.common.console import Sheet
from fuzzyarm.envs.physics.dynamics import Payload
from fuzzyarm.envs.physics.equations import bounds_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.default_reference import reference_family
from fuzzyarm.envs.scenario.disturbances import ConstantForce, Disturbance, EncoderNoise, MachiningForce
from fuzzyarm.envs.scenario.reference import Reference
from fuzzyarm.envs.vector import FuzzyArmVectorEnv
from fuzzyarm.eval.episodes.loop import episodes
from fuzzyarm.eval.provenance import made_now
from fuzzyarm.eval.stability._linearisation import remark_on
from fuzzyarm.fuzzy_policy.policy import Predictor
from fuzzyarm.policies import load_policy

if TYPE_CHECKING:
    from rich.console import Console

__all__ = ["ANCHORS", "closeness", "print_scores", "scores"]

_GROUPS = ("no load", "machining", "push", "payload and noise")
"""The four loads: none; 0.3 to 1 times the force of Case 2; a constant force of 50 to 150 N in any direction that sets
in between a fifth and a half of the motion; and 1 to 5 kg at the tip, with noise of 10 µrad and 1 mrad/s on the
encoders. Training on the registered task never draws the last two."""
ANCHORS = ("computed-torque", "learned-observer")
"""The policies that define N = 0 and N = 100."""
_RESOLUTION, _LOST = 1e-5, 0.2  # s and R [m]
_EACH = 32  # episodes of a group
_PERIOD = 1e-3


@dataclasses.dataclass(frozen=True)
class _HeldOut:
    """Held-out episodes: the arm, reference and disturbance of each, and the index of its load in `_GROUPS`."""

    arms: tuple[ArmParameters, ...]
    references: tuple[Reference, ...]
    disturbances: tuple[Disturbance, ...]
    groups: np.ndarray


@dataclasses.dataclass(frozen=True)
class _Score:
    """The results of a policy on the held-out set.

    Arrays (episodes,): `S` is the mean defined in the module's docstring, `rms` the root mean square tip error until
    the end [m], `rate` the root mean square rate of the torque [N m/s], and `lost` whether the tip error exceeded R at
    some instant or the episode ended early. `saturated` is the share of all steps with a motor at its torque limit.
    """

    S: np.ndarray
    rms: np.ndarray
    rate: np.ndarray
    lost: np.ndarray
    saturated: float


def _held_out(version: str = __version__, each: int = _EACH) -> _HeldOut:
    """Return the held-out episodes of a version of the package, `each` of them in every group."""
    seed = int.from_bytes(hashlib.sha256(f"fuzzyarm {version} held-out".encode()).digest()[:8], "big")
    rng, arm = np.random.default_rng(seed), ArmParameters()
    family = reference_family(arm, 2 * each, seed=int(rng.integers(2**32)))
    force = MachiningForce()
    arms, references, disturbances = [], [], []
    for group in range(len(_GROUPS)):
        for _ in range(each):
            arms.append(_drawn(arm, rng))
            references.append(family[rng.integers(len(family))])
            share, angle, push, start = rng.uniform((0.3, -np.pi, 50.0, 0.2), (1.0, np.pi, 150.0, 0.5))
            scaled = MachiningForce(share * force.base, share * force.swing)
            pushed = ConstantForce(
                (push * np.cos(angle), push * np.sin(angle)), start=float(start * references[-1].duration)
            )
            loaded = Disturbance(payload=Payload(float(rng.uniform(1.0, 5.0))), encoder_noise=EncoderNoise(1e-5, 1e-3))
            options = (Disturbance(), Disturbance(tip_force=scaled), Disturbance(tip_force=pushed), loaded)
            disturbances.append(options[group])
    return _HeldOut(tuple(arms), tuple(references), tuple(disturbances), np.repeat(np.arange(len(_GROUPS)), each))


def _drawn(arm: ArmParameters, rng: np.random.Generator) -> ArmParameters:
    """Return the arm with random factors on its constants, in the ranges of the randomisation "plants"."""
    widths = {
        ("mass", "inertia"): 0.1, ("motor_inertia",): 0.1, ("stiffness",): 0.2, ("damping",): 0.5,
        ("static_friction", "coulomb_friction"): 0.5, ("viscous_friction",): 0.5,
    }  # fmt: skip
    changed: dict[str, Any] = {}
    for names, width in widths.items():
        factors = rng.uniform(1.0 - width, 1.0 + width, 2)
        changed |= {name: tuple((factors * np.array(getattr(arm, name))).tolist()) for name in names}
    return dataclasses.replace(arm, **changed)


def closeness(error: np.ndarray) -> np.ndarray:
    """Return 1 - ln(1 + d/s)/ln(1 + R/s) of tip errors d (samples,) [m], s = 10 µm, R = 0.2 m; 0 where d > R."""
    near = 1.0 - np.log1p(error / _RESOLUTION) / np.log1p(_LOST / _RESOLUTION)
    return np.where(error <= _LOST, near, 0.0)


def _score_of(policy: Predictor, chosen: _HeldOut) -> _Score:
    """Return the results of a policy in the held-out episodes `chosen`."""
    count = len(chosen.arms)
    envs = FuzzyArmVectorEnv(
        count, disturbance=chosen.disturbances, reference=chosen.references, parameters=chosen.arms, threads=1
    )
    steps = np.array([round(reference.duration / _PERIOD) for reference in chosen.references])
    earned, squares, done, rate, limited = np.zeros((5, count))
    limit = bounds_of(chosen.arms[0]).torque
    lost, before = np.zeros(count, dtype=bool), None
    for step in episodes(envs, policy, envs.reset(seed=0)):
        error, torque = step.info["tip_error"], step.info["torque"]
        earned += np.where(step.running, closeness(error), 0.0)
        squares += np.where(step.running, error, 0.0) ** 2
        if before is not None:
            rate += np.where(step.running, np.mean((torque - before) ** 2, axis=1), 0.0)
        limited += step.running & (np.abs(torque) >= limit).any(axis=1)
        before, lost, done = torque, lost | (step.running & (error > _LOST)), done + step.running
    short = done < steps - 1
    return _Score(
        earned / steps,
        np.sqrt(squares / done),
        np.sqrt(rate / done) / _PERIOD,
        lost | short,
        float(limited.sum() / done.sum()),
    )


def scores(policies: Mapping[str, Predictor], chosen: _HeldOut | None = None) -> dict[str, Any]:
    """Return the scores by label of `policies` and `ANCHORS`, for JSON; `chosen`: the episodes, None: `_held_out()`."""
    chosen = _held_out() if chosen is None else chosen
    found = {name: _score_of(load_policy(name), chosen) for name in ANCHORS}
    low, high = (float(found[name].S.mean()) for name in ANCHORS)

    def row(score: _Score) -> dict[str, Any]:
        millimetres = 1e3 * np.quantile(score.rms, [0.5, 0.9, 0.99])
        each = {group: 100.0 * float(score.S[chosen.groups == k].mean()) for k, group in enumerate(_GROUPS)}
        return {
            "N": 100.0 * (float(score.S.mean()) - low) / (high - low),
            "S": float(score.S.mean()),
            "rms_mm": dict(zip(("median", "90 %", "99 %"), millimetres.tolist(), strict=True)),
            "torque_rate": float(np.sqrt(np.mean(score.rate**2))),
            "lost_percent": 100.0 * float(score.lost.mean()),
            "saturated_percent": 100.0 * score.saturated,
            "S_percent_by_group": each,
        }

    mine = {label: found.get(label) or _score_of(policy, chosen) for label, policy in policies.items()}
    own = {label: row(score) for label, score in mine.items()}
    remarks = [remark_on(name, policies[name], ArmParameters(), _PERIOD, one.saturated) for name, one in mine.items()]
    anchors = {name: row(found[name]) for name in ANCHORS if name not in own}
    made = made_now("fuzzyarm score")
    return {
        **made,
        "version": __version__,
        "episodes": len(chosen.arms),
        "policies": own,
        "anchors": anchors,
        "remarks": [line for line in remarks if line],
    }


def print_scores(document: Mapping[str, Any], console: Console) -> None:
    """Print the document of `scores` as a table and, for several policies, the mean and the lowest of the scores N."""
    table = []
    for name, one in [*document["policies"].items(), *document["anchors"].items()]:
        rms = (f"{value:.3g}" for value in one["rms_mm"].values())
        table.append([name, f"{one['N']:.1f}", *rms, f"{1e-3 * one['torque_rate']:.2g}", f"{one['lost_percent']:.1f}"])
    headings = ["policy", "N", "median rms [mm]", "90 %", "99 %", "torque rate [kN m/s]", "lost [%]"]
    Sheet(headings, table).print(console)
    numbers = [one["N"] for one in document["policies"].values()]
    if len(numbers) > 1:
        console.print(f"over {len(numbers)} policies: mean score N {np.mean(numbers):.1f}, worst N {min(numbers):.1f}")
