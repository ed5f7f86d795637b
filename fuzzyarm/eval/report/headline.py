"""The sentence at the head of the page: who won overall and in each case, by the rule of the leaderboard."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from html import escape

from fuzzyarm.envs.scenario.cases import CASES
from fuzzyarm.eval.episodes.metrics import LOST, millimetres
from fuzzyarm.eval.evaluation.ranking import Standing
from fuzzyarm.eval.report.chart import digits

__all__ = ["headline", "rule"]

NAMED = 3  # policies that are named one after the other; of more, only their number is told


def headline(standings: Sequence[Standing], titles: Mapping[str, str] | None = None) -> str:
    """Return the sentence as HTML.

    A value is that of the leaderboard: the score overall, the rms tip error in a case. Policies whose values read the
    same win together. A policy that lost the path in a case cannot win it, nor overall.

    Args:
        standings: of all policies of one evaluation, see `standings_of`.
        titles: of the cases by name; None: those of the two-joint arm.
    """
    known = {name: case.title for name, case in CASES.items()} if titles is None else titles
    if len(standings) == 1:
        return _alone(standings[0], known)
    scores = {standing.policy: standing.score.mean for standing in standings if standing.score is not None}
    cases = list(standings[0].rms)
    wins: dict[tuple[str, ...], list[str]] = {}  # what each group of winners won
    nobody = []
    if len(cases) > 1 and scores:
        wins[_winners(scores)] = [f"overall with a score of {_length(min(scores.values()))}"]
    for case in cases:
        errors = {standing.policy: standing.rms[case] for standing in standings}
        held = {policy: error for policy, error in errors.items() if error is not None}
        if held:
            won = f"in {_title(known[case])} with {_length(min(held.values()))}\u00a0rms"
            wins.setdefault(_winners(held), []).append(won)
        else:
            nobody.append(_title(known[case]))
    parts = [
        f"{_names(names)} {'wins' if len(names) == 1 else 'tie'} {_series(where)}" for names, where in wins.items()
    ]
    if nobody:
        parts.append(f"nobody held the path in {_series(nobody)}")
    return "; ".join([*parts, *_lost(standings), *_overlap(standings)]) + "."


def rule(standings: Sequence[Standing]) -> str:
    """Return what a win is, in words."""
    several = standings[0].episodes > len(standings[0].rms)
    seeds = "; interquartile means over the seeds" if several else ""
    score = "" if len(standings[0].rms) == 1 else " Score: the largest tip error of all cases, as in the leaderboard."
    return (
        f"A case is won by the smallest rms tip error{seeds}.{score} A policy that ended early or was more than "
        f"{LOST:g} mm off lost the path and is not ranked."
    )


def _alone(standing: Standing, titles: Mapping[str, str]) -> str:
    """Return the sentence of an evaluation of one policy, which has nobody to win against."""
    name = _names([standing.policy])
    if standing.score is None:
        return f"{name} ran alone and lost the path in {standing.lost} of {_episodes(standing.episodes)}."
    errors = [
        f"{_length(error)} in {_title(titles[case])}" for case, error in standing.rms.items() if error is not None
    ]
    return f"{name} ran alone; its rms tip error is {_series(errors)}."


def _winners(values: Mapping[str, float]) -> tuple[str, ...]:
    """Return the policies whose value reads the same as the smallest one."""
    smallest = _length(min(values.values()))
    return tuple(policy for policy, value in values.items() if _length(value) == smallest)


def _lost(standings: Sequence[Standing]) -> list[str]:
    """Return the policies that lost the path, the one that lost it most often last, and in how many episodes."""
    lost = sorted((standing for standing in standings if standing.lost), key=lambda standing: standing.lost)
    if not lost:
        return []
    overall = " overall" if len(standings[0].rms) > 1 else ""
    if len(lost) == 1:
        often = f"{lost[0].lost} of {_episodes(lost[0].episodes)}"
        return [f"{_names([lost[0].policy])} lost the path in {often} and is not ranked{overall}"]
    named = [f"{_names([one.policy])} (in {one.lost} of {_episodes(one.episodes)})" for one in lost[:NAMED]]
    if len(lost) > NAMED:
        named.append(_others(len(lost) - NAMED))
    return [f"{_series(named)} lost the path and are not ranked{overall}"]


def _overlap(standings: Sequence[Standing]) -> list[str]:
    """Return the policies whose scores the seeds do not tell apart from the best one."""
    scores = [(standing.policy, standing.score) for standing in standings if standing.score is not None]
    scores.sort(key=lambda pair: pair[1].mean)
    if len(scores) < 2:
        return []
    (first, best), *others = scores
    alike = [
        policy for policy, score in others if best.high is not None and score.low is not None and score.low <= best.high
    ]
    return [f"the 95 % interval of the score of {_names([first])} overlaps that of {_names(alike)}"] if alike else []


def _title(title: str) -> str:
    """Return the title of a case with its explanation in brackets."""
    return escape(re.sub(r"^([^:]+): (.+)$", r"\1 (\2)", title))


def _length(error: float) -> str:
    return f"{escape(millimetres(error, digits))}\u00a0mm"


def _episodes(count: int) -> str:
    return f"{count} {'episode' if count == 1 else 'episodes'}"


def _others(count: int) -> str:
    return f"{count} {'other' if count == 1 else 'others'}"


def _names(policies: Sequence[str]) -> str:
    names = [f"<strong>{escape(policy)}</strong>" for policy in policies]
    return _series(names if len(names) <= NAMED + 1 else [*names[:NAMED], _others(len(names) - NAMED)])


def _series(parts: Sequence[str]) -> str:
    """Return "a", "a and b" or "a, b and c"."""
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"
