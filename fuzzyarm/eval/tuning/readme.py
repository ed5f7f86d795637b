"""The page of a tuning, in Markdown: the decision for each policy, its rule, and the margins of the policy."""

from collections.abc import Sequence
from typing import Any

from fuzzyarm.common.arithmetic import at_most
from fuzzyarm.common.console import Sheet
from fuzzyarm.envs.physics.equations import AnyArm
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.default_reference import default_reference
from fuzzyarm.eval.stability.margins import margin_cells, margin_notes
from fuzzyarm.eval.tuning._finding import PERIOD, Finding, heaviest
from fuzzyarm.eval.tuning._fuzzy_gains import FUZZY, PROVEN_SETS
from fuzzyarm.fuzzy_policy.laws.adaptive.belief import AdaptiveWeights
from fuzzyarm.fuzzy_policy.laws.observer_gains import ObserverWeights
from fuzzyarm.policies.registry import ADAPTIVE_OBSERVER, ELASTIC_OBSERVER, TIP

__all__ = ["README", "decision", "summary"]

README = "README.md"
"""The file of the page."""

_USUAL: dict[str, Any] = {ELASTIC_OBSERVER: ObserverWeights(), ADAPTIVE_OBSERVER: AdaptiveWeights()}

_WORDS = {  # and unit, by the name of a number
    "alpha": ("alpha", "1/s"),
    "gamma": ("gamma", "rad/(N m)"),
    "fastest_pole": ("fastest pole", "1/s"),
    "bandwidth": ("bandwidth", "rad/s"),
    "link_angle": ("link angle", "rad"),
    "link_velocity": ("link velocity", "rad/s"),
    "case_1_joint_error_rms_mrad": ("motor error, rms", "mrad"),
    "joint_error_rms_mrad": ("motor error, rms", "mrad"),
    "gain_margin_upper": ("loop gain up to", ""),
    "gain_margin_upper_1_sample_later": ("one sample later up to", ""),
    "gain_margin_upper_delayed": ("one sample later up to", ""),
    "radius_worst_condition": ("largest spectral radius of all combinations", ""),
    "objective_mm": ("objective", "mm"),
    "tip_deviation_mm": ("tip deflected by any friction, linear", "mm"),
    "tip_bound_mm": ("proven bound on the tip error with -tip", "mm"),
    "tip_bound_near_mm": ("for plants near the arm", "mm"),
    "objective_of_table_1_weights_mm": ("with the weights of Table 1", "mm"),
}


def decision(finding: Finding) -> str:
    """Return one line with the parameters chosen for a policy, or with the reason why it was left out."""
    if finding.chosen is None:
        return f"left out. {finding.notes[-1] if finding.notes else ''}".rstrip()
    usual = _USUAL.get(finding.policy)
    changed = {name: value for name, value in finding.chosen.items() if usual is None or value != getattr(usual, name)}
    if not changed:
        return "the weights of Table 1"
    named = ", ".join(_with_unit(name, value) for name, value in changed.items())
    return named if usual is None else f"{named}; its other weights are those of Table 1"


def _with_unit(name: str, value: float | None) -> str:
    words, unit = _WORDS.get(name, (name.replace("_", " "), ""))
    return f"{words} none" if value is None else f"{words} {value:.4g} {unit}".rstrip()


def summary(arm: AnyArm, folder: str, findings: Sequence[Finding], margins: dict[str, Any]) -> str:
    """Return the text of the README for a tuning in a folder of this name; `margins` is from `measure_margins`."""
    name = "A two-joint arm" if isinstance(arm, ArmParameters) else arm.name
    reference = default_reference(arm)
    parts = [
        f"# {name}, tuned",
        f"`fuzzyarm tune` chose the numbers of these policies for the arm of `robot.toml`, at a control period of "
        f"{1e3 * PERIOD:g} ms. It used the arm's default path, which takes {reference.duration:g} s, and margins on "
        f"the sampled elastic arm, with up to {heaviest(arm):g} kg at the tip, but no case with loads.",
        f"```\nfuzzyarm evaluate --robot {folder}\nfuzzyarm margins --robot {folder}\n"
        f"fuzzyarm sweep --robot {folder} --out sweep\n```",
        "## Decisions",
    ]
    for finding in findings:
        parts.append(f"**{finding.policy}**: {decision(finding)}")
        known = ", ".join(_with_unit(name, value) for name, value in finding.measured.items() if value is not None)
        measured = f" Measured: {known}." if known else ""
        parts.append(f"{finding.rule} Candidates: {finding.tried}.{measured}")
        parts += [f"Note: {note}" for note in finding.notes if finding.chosen is not None]
        if finding.chosen is not None and finding.unstable:
            parts.append(f"Not stable in these conditions (measured): {', '.join(finding.unstable)}.")
    headings, cells = margin_cells(margins["rows"])
    head, *rows = zip(headings, *cells, strict=True)  # a column for each policy
    proven = "Nothing: no controller file of this folder is proven."
    if any(finding.policy == FUZZY and finding.chosen is not None for finding in findings):
        proven = (
            f"{FUZZY}: every inequality of the file is proven in exact arithmetic, for the rigid arm in continuous "
            f"time; `fuzzyarm verify {FUZZY}.json` proves them again and explains their meaning. Nothing is proven "
            "for the other policies."
        )
    parts += ["## Margins", Sheet(head, rows).markdown(), *margin_notes(margins), "## Proven", proven]
    parts += [_bounds_in_words(finding.policy + TIP, folder, finding.measured) for finding in findings]
    if not isinstance(arm, ArmParameters):
        parts.append(
            f"No bound on the tip error was sought; `fuzzyarm prove --robot {folder} --policy computed-torque{TIP}` "
            "looks for one."
        )
    return "\n\n".join(filter(None, parts)) + "\n"


def _bounds_in_words(policy: str, folder: str, measured: dict[str, float | None]) -> str:
    """Return a sentence on the proven bounds of a policy's tip error, with the proof command; "" without a bound.

    `policy` is its name in the folder of the tuning; `measured` has the bounds [mm], see `PROVEN_SETS`.
    """
    found = {name: measured.get(key) for name, (key, _) in PROVEN_SETS.items()}
    known = {name: bound for name, bound in found.items() if bound is not None}
    if not known:
        return ""
    within = ", ".join(f"within {at_most(bound, 2)} mm for {PROVEN_SETS[name][1]}" for name, bound in known.items())
    return (
        f"{policy}: tip {within}, proven at every instant of the default circle, for the elastic arm with sampled "
        f"control; `fuzzyarm prove --policy {folder}/{policy} --set {list(known)[-1]}` proves it again."
    )
