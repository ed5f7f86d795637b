"""The design of a proven controller of the form "semidefinite" for a robot with any number of joints."""

import dataclasses
import math
import time
from collections.abc import Callable
from importlib.metadata import version

import numpy as np

from fuzzyarm.common.arithmetic import at_least, at_most
from fuzzyarm.common.checks import instance, real, whole
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.fuzzy_policy.controller import GAINS, RATES
from fuzzyarm.fuzzy_policy.laws.observer_gains import ONE_AT_A_TIME, places_of, worst_radius
from fuzzyarm.fuzzy_policy.laws.scheduled import linear_scheduled
from fuzzyarm.fuzzy_policy.scheduled_controller import MOST_PREMISES, Premise, ScheduledController, speeds_of
from fuzzyarm.proof.certificate import Certificate
from fuzzyarm.proof.scheduled_certificate import certify_scheduled, schedule_rate
from fuzzyarm.synthesis._designer import DesignFailed
from fuzzyarm.synthesis._inertia_metric import InertiaMetric, best_premise, fitted_metric
from fuzzyarm.synthesis._scalar_design import Feedback, best_feedback, feedback_for_gamma, smallest_pole
from fuzzyarm.synthesis.specification import ALPHAS

__all__ = ["ScheduledDesign", "ScheduledSpecification", "describe_scheduled", "design_scheduled"]

_MOST_JOINTS = 7  # more would need more than one split of the chain

_CONTROL_PERIOD = 1e-3  # s, for the margins by which a decay rate is chosen
_POLE_FACTOR = 1.5  # default fastest pole, relative to the smallest possible one, if γ is not specified either
_SAMPLES = 2000
"""Number of sampled angles to which the bounds on the inertia are fitted."""
_SEARCH_SAMPLES = 400  # sampled angles for the choice of a premise
# Shares by which the bounds from the samples are widened, in turn, until the proof succeeds.
_WIDENINGS = (2e-3, 1e-2, 4e-2)


@dataclasses.dataclass(frozen=True)
class ScheduledSpecification:
    """The requirements of a design; without γ and `fastest_pole`, the latter is 1.5 times its smallest possible value.

    The theorem is for the rigid arm in continuous time. Without `alpha`, the decay rate is the largest of `ALPHAS` for
    which the loop on the elastic arm, sampled at 1 kHz, is stable at random postures with twice its gain and with one
    sample of delay. If there is no such rate, it is the last of `ALPHAS`.

    Attributes:
        premises: the kept premises; None to find the best ones automatically.
        rules: 1, 2, 4, 8 or 16, doubled by each premise; ignored if `premises` are given.
        alpha: decay rate [1/s]; None: see above.
        gamma: bound on the L2 gain [rad/(N m)], in Euclidean norms; None: the smallest for this `fastest_pole`.
        fastest_pole: bound on the size of the closed loop's poles [1/s]; None: the smallest for this `gamma`.

    Raises:
        TypeError: a value is of the wrong type.
        ValueError: a value is out of range, or both γ and the fastest pole are given.
    """

    premises: tuple[Premise, ...] | None = None
    rules: int = 1
    alpha: float | None = None
    gamma: float | None = None
    fastest_pole: float | None = None

    def __post_init__(self) -> None:
        if self.rules not in [2**k for k in range(MOST_PREMISES + 1)]:
            raise ValueError(f"rules = {self.rules} is out of range; allowed: 1, 2, 4, 8 or 16")
        whole("rules", self.rules, low=1)
        slowest = ALPHAS[-1] if self.alpha is None else self.alpha
        real("alpha", slowest, "1/s", low=RATES[0], high=RATES[1])
        if self.gamma is not None:
            real("gamma", self.gamma, "rad/(N m)", low=GAINS[0], high=GAINS[1])
        if self.fastest_pole is not None:
            real("fastest_pole", self.fastest_pole, "1/s", above=slowest, high=RATES[1])
            if self.gamma is not None:
                raise ValueError("give either gamma or fastest_pole, not both, because each follows from the other")


@dataclasses.dataclass(frozen=True)
class ScheduledDesign:
    """A proven controller, and the times of its computation.

    Attributes:
        controller: the controller, ready to be saved.
        certificate: certificate of all claims of the controller, all proven.
        metric_seconds: time of the search for premises and bounds on the inertia [s].
        proof_seconds: time of computing and proving the feedback [s].
    """

    controller: ScheduledController
    certificate: Certificate
    metric_seconds: float
    proof_seconds: float


def design_scheduled(specification: ScheduledSpecification, robot: Robot) -> ScheduledDesign:
    """Return a controller of a robot for a specification, proven from its stored values.

    Raises:
        DesignFailed: no provable controller was found.
    """
    n = len(instance("robot", robot, Robot))
    if n > _MOST_JOINTS:
        raise DesignFailed(f"{robot.name} has {n} joints; a proof is available for at most {_MOST_JOINTS} joints")
    begin = time.perf_counter()
    premises = instance("specification", specification, ScheduledSpecification).premises
    alpha = specification.alpha or ALPHAS[0]
    if premises is None:
        if specification.rules > 2 ** (n - 1):
            raise DesignFailed(
                f"{robot.name} has {n} joints, which allow at most {2 ** (n - 1)} rules: choose fewer rules"
            )
        premises = ()
        while 2 ** len(premises) < specification.rules:
            premises = (*premises, best_premise(robot, premises, alpha=alpha, count=_SEARCH_SAMPLES))
    for premise in premises:
        if premise.joint >= n:
            raise DesignFailed(
                f"the premise {premise.name} belongs to joint {premise.joint + 1}, but {robot.name} has {n} joints; "
                f"choose premises of joints 2 to {n}"
            )
    metric = fitted_metric(robot, premises, alpha=alpha, count=_SAMPLES)
    searched = time.perf_counter() - begin
    begin = time.perf_counter()
    failed = ""
    for widening in _WIDENINGS:
        controller = _chosen(specification, robot, metric, widening)
        certificate = certify_scheduled(controller)
        if certificate.proven:
            return ScheduledDesign(controller, certificate, searched, time.perf_counter() - begin)
        failed = next(claim.name for claim in certificate.claims if not claim.proven)
    raise DesignFailed(f"the design is not proven: the inequality {failed} fails; choose a smaller alpha or more rules")


def _chosen(
    specification: ScheduledSpecification, robot: Robot, metric: InertiaMetric, widening: float
) -> ScheduledController:
    """Return the controller with the decay rate stated in `ScheduledSpecification`; arguments as for `_controller`."""
    if specification.alpha is not None:
        return _controller(specification, robot, metric, widening, specification.alpha)
    places, found, reason = places_of(robot, _CONTROL_PERIOD), None, None
    for alpha in ALPHAS:
        try:
            found = _controller(specification, robot, metric, widening, alpha)
        except DesignFailed as error:  # the specified pole is too slow, or γ too small, for this rate
            reason = error
            continue
        if all(worst_radius(place, linear_scheduled(found, place), ONE_AT_A_TIME) < 1.0 for place in places):
            break
    if found is None:
        raise reason or AssertionError
    return found


def _controller(
    specification: ScheduledSpecification, robot: Robot, metric: InertiaMetric, widening: float, alpha: float
) -> ScheduledController:
    """Return the controller for a decay rate α [1/s] and a metric with bounds widened by the fraction `widening`."""
    inertia = (1.0 - widening) * metric.inertia
    kappa = _rounded(metric.kappa * (1.0 + 2.0 * widening), math.ceil)
    floor = _rounded(metric.floor * (1.0 - 3.0 * widening), math.floor)
    rates = np.array([_rounded(rate * (1.0 + widening) + 1e-4, math.ceil) for rate in metric.rates.tolist()])
    fast = alpha + float(rates @ speeds_of(robot, metric.premises))
    feedback = _feedback(specification, kappa, fast, floor)
    return ScheduledController(
        robot=robot,
        premises=metric.premises,
        inertia=0.5 * (inertia + np.swapaxes(inertia, -1, -2)),
        kappa=kappa,
        floor=floor,
        rates=rates,
        split=metric.split,
        distal_low=0.5 * (metric.distal_low + metric.distal_low.T),
        distal_high=0.5 * (metric.distal_high + metric.distal_high.T),
        feedback=feedback.k,
        lyapunov=feedback.X,
        alpha=alpha,
        gamma=_rounded(feedback.gamma, math.ceil),
        fastest_pole=_rounded(feedback.fastest_pole, math.ceil),
        origin={
            "objective": "smallest fastest pole" if specification.gamma is not None else "smallest L2 gain",
            **{name: version(name) for name in ("fuzzyarm", "clarabel")},
        },
    )


def _feedback(specification: ScheduledSpecification, kappa: float, rate: float, floor: float) -> Feedback:
    lowest = smallest_pole(kappa, rate)
    if specification.gamma is not None:
        found = feedback_for_gamma(kappa, rate, specification.gamma * floor)
        if found is None:
            raise DesignFailed(f"no feedback reaches gamma = {specification.gamma:g} rad/(N m): choose a larger gamma")
        return found
    pole = _POLE_FACTOR * lowest if specification.fastest_pole is None else specification.fastest_pole
    found = best_feedback(kappa, rate, pole)
    if found is None:
        raise DesignFailed(
            f"no feedback was found for fastest_pole = {pole:.6g} 1/s; with this robot, alpha and number of rules, it "
            f"must be well above {lowest:.6g} 1/s: raise fastest_pole, lower alpha, or use more rules"
        )
    return found


def _rounded(value: float, towards: Callable[[float], int], digits: int = 5) -> float:
    """Return a positive number rounded to `digits` digits, up or down as `towards` (ceil or floor) says."""
    scale = 10.0 ** (digits - 1 - math.floor(math.log10(value)))
    return float(f"{towards(value * scale) / scale:.{digits}g}")


def describe_scheduled(result: ScheduledDesign) -> str:
    """Return a readable description of the controller and the proof."""
    c, certificate = result.controller, result.certificate
    kept = ", ".join(premise.name for premise in c.premises) or "none"
    rate = schedule_rate(c)
    fixed, speed, integral = c.feedback
    lines = [
        f"{c.robot.name}, {len(c.robot)} joints; {c.rules} rule{'s' if c.rules > 1 else ''}, kept premises: {kept}; "
        "semidefinite form, with integral",
        f"kappa = {at_most(c.kappa, 5)}, mu = {at_most(int(rate.p) / int(rate.q), 4)} 1/s; alpha = "
        f"{at_least(c.alpha, 6)} 1/s, fastest pole {at_most(c.fastest_pole, 6)} 1/s, gamma = {at_most(c.gamma, 4)} s^2 "
        f"in the norms of the inertia; {c.origin['objective']}",
        f"premises and inertia found in {result.metric_seconds:.1f} s, all {len(certificate.claims)} claims proven in "
        f"{result.proof_seconds:.1f} s, smallest margin {certificate.proof_margin:.2g}",
        f"feedback -M_hat(q) (k_p e + k_d de/dt + k_i x_I): k_p = {fixed:.6g} 1/s^2, k_d = {speed:.6g} 1/s, "
        f"k_i = {integral:.6g} 1/s^3",
        "",
        "M_hat of each rule [kg m^2]:",
    ]
    for rule, inertia in enumerate(c.inertia):
        for row, entries in enumerate(inertia):
            head = f"{rule + 1:>4}  " if row == 0 else "      "
            lines.append(head + "".join(f"{entry:10.4f}" for entry in entries))
    return "\n".join([*lines, "", certificate.statement])
