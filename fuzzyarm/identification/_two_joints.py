"""The parameters of a two-joint arm from logs, in stages.

    rigid start     the least-squares fit of `_rigid.fit_rigid`
    rigid           output error over windows of 0.4 s; a parameter that the logs do not determine keeps its start value
    Stribeck        static friction in addition to Coulomb friction, if requested
    sticking        the rigid arm again, with springs so stiff that they have no effect, and with exact sticking
    elastic         stiffness, damping and both rotor inertias, over windows of 0.2 s

A later stage counts only if the *held-out error* falls, the rms error of predicted angles: the logs are divided into at
most five groups (a single log is cut into three parts), and each group is predicted over 0.5 s from measured states
with the parameters found from the other groups.
"""

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from fuzzyarm.envs.physics.dynamics import arm_constants
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.identification._output_error import Fit, Search, fitted
from fuzzyarm.identification._rigid import (
    UNKNOWNS,
    arm_of,
    fit_rigid,
    rigid_arm,
    rotor_share,
    start_of,
    static_ratio,
)
from fuzzyarm.identification._simulation import ELASTIC, RIGID, Simulator, Windows, rms, rms_errors, windows_of
from fuzzyarm.identification.log import Log

__all__ = ["HORIZON", "Stages", "estimated", "units_of"]

_WINDOW, _ELASTIC_WINDOW = 0.4, 0.2  # s
_POINTS, _ELASTIC_POINTS = 20, 40  # samples of a window that are compared
_MOST, _MOST_ELASTIC = 400, 120  # windows of all logs
HORIZON, _EVERY = 0.5, 0.25  # s: duration of a prediction; time between the beginnings of two predictions
_GROUPS, _PARTS = 5, 3
_STEPS, _MORE_STEPS, _ELASTIC_STEPS = 15, 3, 8
_CLOSE, _ELASTIC_CLOSE = 1e-4, 1e-3  # relative decrease of the cost below which a search ends
_BETTER, _NOT_WORSE = 0.98, 1.01  # largest ratio of held-out errors, later stage over earlier: product; each joint
_LIKELY, _LIKELY_ROTOR, _LIKELY_SPRING = 0.5, 2.0, 1.5  # prior deviations: shares of the value (two), logarithm
_ROTOR = 0.1, 0.9  # assumed limits of the rotor's share in the inertia of rotor and link
_FRICTION = 0.2  # scale of friction, as a share of a joint's torque
_STIFF, _WIDEST = 60.0, 3.0  # Hz; largest factor between a stiffness that counts as determined and its interval's ends
_LEAST, _FARTHEST = 1e-3, 2.0  # lower bound of an unknown, in scales; upper bound of a mass center, in link lengths
_MEDIAN, _FOURTH = 0.6744897501960817, 70.0**0.5  # median of |x| for normal x; norm of the coefficients 1, -4, 6, -4, 1
_PLACES = {one.name: k for k, one in enumerate(UNKNOWNS)}


@dataclasses.dataclass(eq=False)
class Stages:
    """The results of the stages of an estimation; the attributes of stages that were not reached are None."""

    start: ArmParameters
    arm: ArmParameters  # the best so far
    found: Fit | None = None  # result of the last stage that counts
    untold: tuple[str, ...] = ()  # parameters of the rigid arm that the logs do not determine
    is_elastic: bool = False
    is_sticking: bool = False  # whether the last stage that counts has exact stick
    start_error: np.ndarray | None = None  # held-out error of the start's rigid arm [rad], (2,)
    motion: np.ndarray | None = None  # rms motion of the joints in the predicted windows [rad], (2,)
    errors: dict[str, np.ndarray] = dataclasses.field(default_factory=dict)  # held-out errors of the stages [rad]
    others: list[Fit] = dataclasses.field(default_factory=list)  # results of every stage, whether it counts or not
    interrupted: bool = False

    def keep(self, found: Fit, untold: tuple[str, ...], *, is_elastic: bool = False, is_sticking: bool = False) -> None:
        """Adopt the result of a stage; `untold` names parameters of the rigid arm that the logs do not determine.

        `is_elastic`: the stage determines springs; `is_sticking`: it has exact sticking and very stiff springs. Any
        other stage without static friction keeps the start's ratio of static to Coulomb friction. Unless `is_elastic`,
        rotor 1 has its start inertia if that is 10 % to 90 % of the sum found for rotor 1 and link 1.
        """
        theta = found.theta.copy()
        if is_sticking:
            for k, one in enumerate(UNKNOWNS):
                if one.field in ("stiffness", "damping"):
                    theta[k] = start_of(self.start)[k]
        if not (is_elastic or is_sticking or any(name in _RISES for name in found.search.names)):
            for joint, ratio in enumerate(static_ratio(self.start)):
                theta[_PLACES[f"static_friction[{joint}]"]] = ratio * theta[_PLACES[f"coulomb_friction[{joint}]"]]
        if not is_elastic:  # a rotor from a data sheet, if the sum leaves room for it
            link, rotor, known = _PLACES["inertia[0]"], _PLACES["motor_inertia[0]"], self.start.motor_inertia[0]
            whole = theta[link] + theta[rotor]
            if _ROTOR[0] * whole <= known <= _ROTOR[1] * whole:
                theta[link], theta[rotor] = whole - known, known
        self.is_sticking = is_sticking or is_elastic
        self.found, self.untold, self.is_elastic, self.arm = found, untold, is_elastic, arm_of(theta, self.start)


def estimated(
    logs: Sequence[Log], start: ArmParameters, stribeck: bool, advance: Callable[[], None] = lambda: None
) -> Stages:
    """Return the results of the stages for logs of both motors of one arm, see the module's docstring.

    The search begins at the arm `start`; `stribeck` says whether static friction is also unknown. `advance` is called
    after each step. A KeyboardInterrupt ends the stages; the results so far are returned. ValueError: the arm rests in
    all logs.
    """
    stages = Stages(start, start)
    try:
        _run(stages, logs, stribeck, advance)
    except KeyboardInterrupt:
        if stages.found is None:
            raise
        stages.interrupted = True
    return stages


def _run(stages: Stages, logs: Sequence[Log], stribeck: bool, advance: Callable[[], None]) -> None:
    start = stages.start

    def moving(length: float, every: float, points: int, most: int) -> list[Windows]:
        """Return the windows of each log in which the arm moves; see `windows_of`."""
        parts = [windows_of(log, k, length, every, points, max(most // len(logs), 1)) for k, log in enumerate(logs)]
        return [one for one in parts if len(one)]

    windows, predicted = moving(_WINDOW, _WINDOW, _POINTS, _MOST), moving(HORIZON, _EVERY, 10**9, 10**9)
    if not (windows and predicted):
        raise ValueError(
            "too little excitation: no joint moves by more than 0.02 rad within 0.4 s; record the motion that "
            "--suggest writes"
        )
    motions, noise = [log.smoothed() for log in logs], _noise_of(logs)
    rough = rigid_arm(fit_rigid(motions, start), start)
    torque, speed = (
        np.sqrt(np.mean(np.concatenate([getattr(motion, name) for motion in motions]) ** 2, axis=0))
        for name in ("torque", "dq")
    )
    friction = np.concatenate([torque / np.maximum(speed, 1e-3), torque]) * _FRICTION
    dealt = _Dealt([len(log.angle) for log in logs])

    def fit(
        search: Search,
        simulator: Simulator,
        parts: list[Windows],
        begin: np.ndarray,
        steps: int = _STEPS,
        arm: ArmParameters = start,
    ) -> Fit:
        close = _CLOSE if simulator is RIGID and steps == _STEPS else _ELASTIC_CLOSE
        found = fitted(
            parts, simulator, search, arm, noise=noise, steps=steps, begin=begin, close=close, advance=advance
        )
        if found.interrupted and stages.found is not None:
            raise KeyboardInterrupt
        if steps != _MORE_STEPS:
            stages.others.append(found)
        return found

    def held_out(found: Fit, simulator: Simulator, parts: list[Windows], arm: ArmParameters = start) -> np.ndarray:
        """Return the held-out rms errors (2,) [rad] of the two joints.

        Each group of windows is predicted with `found` refitted to the windows of `parts` in the other groups; `arm` is
        as for `fitted`.
        """
        errors = []
        for group in range(dealt.groups):
            others, own = dealt.chosen(parts, group, inside=False), dealt.chosen(predicted, group, inside=True)
            theta = fit(found.search, simulator, others, found.z, _MORE_STEPS, arm).theta if others else found.theta
            errors += rms_errors(simulator, own, theta, arm)
        return _rms(errors)

    search, begin = _rigid_search(start, friction, stribeck=False), _rigid_numbers(rough)
    found = fit(search, RIGID, windows, begin)
    told = found.told()
    if not told.all():
        search = search.without(~told)
        found = fit(search, RIGID, windows, found.z[told])
    stages.keep(found, tuple(name for name, one in zip(_RIGID_NAMES, told, strict=True) if not one))
    if found.interrupted:
        raise KeyboardInterrupt
    stages.motion = _rms([rms(one.measured - one.measured[:1]) for one in predicted])
    stages.start_error = _rms(rms_errors(RIGID, predicted, _without_static(start_of(start)), start))
    stages.errors["rigid"] = best = held_out(found, RIGID, windows)
    if stribeck:
        search = _rigid_search(start, friction, stribeck=True)
        search = search.without(np.array([name in stages.untold for name in search.names]))
        found = fit(search, RIGID, windows, np.concatenate([found.z, 0.1 * friction[2:]]))
        stages.errors["Stribeck"] = errors = held_out(found, RIGID, windows)
        if _is_better(errors, best):
            best = errors
            stages.keep(found, stages.untold)
    parts, sticking = moving(_ELASTIC_WINDOW, _ELASTIC_WINDOW, _ELASTIC_POINTS, _MOST_ELASTIC), _stiffened(stages.arm)
    if not parts:  # the motion is too slow
        return
    search = _rigid_search(sticking, friction, stribeck=False, ratio=static_ratio(stages.arm))
    search = search.without(np.array([name in stages.untold for name in search.names]))
    found = fit(search, ELASTIC, parts, search.start, _ELASTIC_STEPS, sticking)
    stages.errors["sticking"] = errors = held_out(found, ELASTIC, parts, sticking)
    if _is_better(errors, best):
        best = errors
        stages.keep(found, stages.untold, is_sticking=True)
    search = _elastic_search(stages.arm, friction)
    found = fit(search, ELASTIC, parts, search.start, _ELASTIC_STEPS)
    stages.errors["elastic"] = errors = held_out(found, ELASTIC, parts)
    if _is_better(errors, best) and _tells_springs(found):
        stages.keep(found, (), is_elastic=True)


def _tells_springs(found: Fit) -> bool:
    """Return whether both stiffnesses are known within a factor `_WIDEST`; without intervals, `Fit.told` decides."""
    widths, springs = found.half_widths(), [name.startswith("stiffness") for name in found.search.names]
    return bool(np.all(found.told()[springs] if widths is None else widths[springs] < np.log(_WIDEST)))


class _Dealt:
    """A division of windows into groups: by log, or by time if there is a single log."""

    def __init__(self, lengths: Sequence[int]) -> None:
        self._length = lengths[0] if len(lengths) == 1 else 0
        self.groups = _PARTS if self._length else min(len(lengths), _GROUPS)

    def chosen(self, parts: Sequence[Windows], group: int, *, inside: bool) -> list[Windows]:
        """Return the windows in `parts` of one group if `inside`, else those of all other groups."""
        found = []
        for one in parts:
            if self._length:
                own = one.first * self.groups // self._length == group
            else:
                own = np.full(len(one), one.log % self.groups == group)
            found.append(one.chosen(own == inside))
        return [one for one in found if len(one)]


_RIGID_NAMES = (
    "inertia[0] + motor_inertia[0]", "inertia[1]", "mass_center[0]", "mass_center[1]", "motor_inertia[1]",
    "viscous_friction[0]", "viscous_friction[1]", "coulomb_friction[0]", "coulomb_friction[1]",
)  # fmt: skip
_RISES = ("static_friction[0] - coulomb_friction[0]", "static_friction[1] - coulomb_friction[1]")


def units_of(names: Sequence[str]) -> tuple[str, ...]:
    """Return the unit of each name, which is that of a parameter or of a sum or difference of parameters."""
    units = {one.name: one.unit for one in UNKNOWNS}
    return tuple(units[name.split(" ")[0]] for name in names)


def _rigid_numbers(arm: ArmParameters) -> np.ndarray:
    """Return the values (9,) of the parameters and sums that `_RIGID_NAMES` lists, for an arm."""
    sums = arm.inertia[0] + arm.motor_inertia[0], arm.inertia[1], *arm.mass_center, arm.motor_inertia[1]
    return np.array([*sums, *arm.viscous_friction, *arm.coulomb_friction])


def _matrix(names: Sequence[str], of: dict[str, dict[str, float]]) -> np.ndarray:
    """Return T (17, P) of `Search` for P names of unknowns.

    An unknown is the parameter of its name, unless `of[name]` lists the parameters that it sets, with factors.
    """
    T = np.zeros((len(UNKNOWNS), len(names)))
    for column, name in enumerate(names):
        for parameter, factor in of.get(name, {name: 1.0}).items():
            T[_PLACES[parameter], column] = factor
    return T


def _rigid_search(
    start: ArmParameters, friction: np.ndarray, *, stribeck: bool, ratio: Sequence[float] | np.ndarray = (1.0, 1.0)
) -> Search:
    """Return the search for the rigid arm, with the start as a prior for all parameters except friction.

    `friction` (4,) is the scale of the joints' viscous [N m s/rad], then dry friction [N m]; `ratio` is the ratio of
    static to Coulomb friction of each joint. With `stribeck`, static minus Coulomb friction is also unknown.
    """
    names, z, share = [*_RIGID_NAMES, *(_RISES if stribeck else ())], _rigid_numbers(start), rotor_share(start)
    of = {names[0]: {"inertia[0]": 1.0 - share, "motor_inertia[0]": share}}
    for joint in (0, 1):
        of[f"coulomb_friction[{joint}]"] = {
            f"coulomb_friction[{joint}]": 1.0,
            f"static_friction[{joint}]": ratio[joint],
        }
        of[_RISES[joint]] = {f"static_friction[{joint}]": 1.0}
    matrix, masses, centers = _matrix(names, of), np.array(start.mass), np.array(start.mass_center)
    turning = z[:2] + masses * centers**2
    likely = np.concatenate([_LIKELY * turning, _LIKELY * z[2:4], [_LIKELY_ROTOR * z[4]]])
    dry = len(names) - len(likely)
    fixed = np.where(matrix.any(axis=1), 0.0, start_of(start))
    scale = np.concatenate([likely, friction, friction[2:]])[: len(names)]
    return Search(
        names=tuple(names),
        units=units_of(names),
        matrix=matrix,
        fixed=fixed,
        logarithmic=np.zeros(len(fixed), dtype=bool),
        start=np.concatenate([z, np.zeros(2)])[: len(names)],
        likely=np.concatenate([likely, np.full(dry, np.inf)]),
        scale=scale,
        low=np.concatenate([_LEAST * turning, _LEAST * z[2:4], [_LEAST * turning[1]], np.zeros(dry)]),
        high=np.concatenate([[np.inf] * 2, _FARTHEST * np.maximum(start.length, centers), np.full(dry + 1, np.inf)]),
    )


def _elastic_search(arm: ArmParameters, friction: np.ndarray) -> Search:
    """Return the search that includes rotors, springs and dampers, with `arm` as a prior.

    `friction` (4,): the prior's standard deviations of both joints' viscous [N m s/rad], then dry friction [N m].
    """
    names = [one.name for one in UNKNOWNS if one.field not in ("static_friction", "stribeck_velocity")]
    theta, ratio = start_of(arm), static_ratio(arm)
    of = {f"coulomb_friction[{k}]": {f"coulomb_friction[{k}]": 1.0, f"static_friction[{k}]": ratio[k]} for k in (0, 1)}
    matrix = _matrix(names, of)
    logarithmic = np.array([one.field in ("motor_inertia", "stiffness", "damping") for one in UNKNOWNS])
    place = [_PLACES[name] for name in names]
    exponent, fixed = logarithmic[place], np.where(matrix.any(axis=1), 0.0, theta)
    start = np.where(exponent, np.log(np.maximum(theta[place], 1e-12)), theta[place])
    kinds = [name.split("[")[0] for name in names]
    links = _LIKELY * np.array(arm.inertia) + 0.01 * np.array(arm.mass) * np.array(arm.length) ** 2
    likely = np.concatenate([links, 0.1 * np.array(arm.length), [0.7, 0.7], friction, np.full(4, _LIKELY_SPRING)])
    lows = {"inertia": 1e-3, "mass_center": 1e-3}
    low = np.where(exponent, -np.inf, 0.0)
    for k, kind in enumerate(kinds):
        if kind in lows:
            low[k] = lows[kind] * max(start[k], likely[k])
    return Search(
        names=tuple(names), units=units_of(names), matrix=matrix, fixed=fixed, logarithmic=logarithmic, start=start,
        likely=likely, scale=likely, low=low, high=np.full(len(names), np.inf),
    )  # fmt: skip


def _stiffened(arm: ArmParameters) -> ArmParameters:
    """Return the arm with joints that resonate at the frequency `_STIFF` [Hz], with a damping ratio of 0.1."""
    constants, rotors = arm_constants(arm), np.array(arm.motor_inertia)
    links = np.array([constants.c1, constants.c3])
    reduced, rate = rotors * links / (rotors + links), 2.0 * np.pi * _STIFF
    stiffness, damping = rate**2 * reduced, 0.2 * rate * reduced
    return dataclasses.replace(arm, stiffness=tuple(stiffness.tolist()), damping=tuple(damping.tolist()))


def _without_static(theta: np.ndarray) -> np.ndarray:
    """Return the parameters θ (17,) with static friction equal to Coulomb friction, as in the rigid stage."""
    found = theta.copy()
    for joint in (0, 1):
        found[_PLACES[f"static_friction[{joint}]"]] = theta[_PLACES[f"coulomb_friction[{joint}]"]]
    return found


def _rms(errors: Sequence[np.ndarray]) -> np.ndarray:
    return np.asarray(np.sqrt(np.mean(np.concatenate(errors) ** 2, axis=0)))


def _is_better(errors: np.ndarray, before: np.ndarray) -> bool:
    ratio = errors / before
    return bool(np.prod(ratio) < _BETTER and ratio.max() < _NOT_WORSE)


def _noise_of(logs: Sequence[Log]) -> float:
    """Return the standard deviation of the angles' noise [rad] from their fourth differences; at least 1e-7."""
    rough = [np.median(np.abs(np.diff(log.angle, 4, axis=0))) / (_MEDIAN * _FOURTH) for log in logs]
    return max(float(np.median(rough)), 1e-7)
