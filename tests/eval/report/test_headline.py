"""The sentence at the head of the page: who won, by the rule of the leaderboard, with ties and lost paths."""

import re

import pytest
from support.altered_evaluations import NASTY

from fuzzyarm.envs.scenario.cases import CASES
from fuzzyarm.eval.evaluation.ranking import Standing, rank_policies, standings_of
from fuzzyarm.eval.evaluation.results_file import read_evaluation
from fuzzyarm.eval.evaluation.statistics import Estimate
from fuzzyarm.eval.report.page import headline, rule

TITLES = {name: case.title for name, case in CASES.items()}


def standing(policy, lost=0, score=None, **rms):
    """A standing with these rms tip errors [mm], None where the path was lost."""
    largest = Estimate(max(error or 0.0 for error in rms.values()), None, None)
    return Standing(policy, "", None if lost else score or largest, rms, lost, len(rms), certified=False)


def words(*standings):
    return re.sub(r"</?strong>", "", headline(standings, TITLES)).replace("\u00a0", " ")


def test_one_policy_wins_overall_and_others_their_cases():
    a, b = standing("a", nominal=4.0, machining=1.0), standing("b", nominal=0.5, machining=9.0)
    assert words(a, b) == (
        "a wins overall with a score of 4.00 mm and in Case 2 (machining force) with 1.00 mm rms; "
        "b wins in Case 1 (nominal) with 0.500 mm rms."
    )
    assert headline((a, b), TITLES).startswith("<strong>a</strong> wins")


def test_values_that_read_the_same_tie():
    a, b, c = (standing(name, nominal=error) for name, error in (("a", 2.0), ("b", 2.0004), ("c", 2.01)))
    assert words(a, b, c) == "a and b tie in Case 1 (nominal) with 2.00 mm rms."
    a, b, c = (standing(name, nominal=error) for name, error in (("a", 0.00016), ("b", 0.00048), ("c", 0.0011)))
    assert words(a, b, c) == "a and b tie in Case 1 (nominal) with &lt; 0.001 mm rms."
    many = [standing(NASTY, nominal=1.0), *(standing(f"p{k}", nominal=1.0) for k in range(8))]
    assert words(*many).endswith("p0, p1 and 6 others tie in Case 1 (nominal) with 1.00 mm rms.")
    assert "<img" not in words(*many)


def test_nobody_may_be_left():
    a, b = standing("a", lost=2, nominal=None, machining=None), standing("b", lost=1, nominal=1.0, machining=None)
    assert words(a, b) == (
        "b wins in Case 1 (nominal) with 1.00 mm rms; nobody held the path in Case 2 (machining force); "
        "b (in 1 of 2 episodes) and a (in 2 of 2 episodes) lost the path and are not ranked overall."
    )


@pytest.mark.slow
def test_the_winner_leads_the_leaderboard_and_stands_on_the_page(folder):
    stored = read_evaluation(folder)
    standings = standings_of(stored.config, stored.rows, stored.certificates)
    first = rank_policies([folder]).standings[0]
    text = headline(standings, TITLES)
    assert text.startswith(
        f"<strong>{first.policy}</strong> wins overall with a score of {first.score.mean:#.3g}\u00a0mm"
    )
    page = (folder / "report.html").read_text()
    assert f'<p id="headline">{text}</p>' in page and rule(standings) in page
