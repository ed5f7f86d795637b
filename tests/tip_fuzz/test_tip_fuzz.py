"""No plant leaves a tube that the checker accepts, and faults of the proof are found."""

import dataclasses
import json
import sys

import numpy as np
import pytest

from fuzzyarm.policies.tip_bound import TipClaim
from fuzzyarm.proof.tip.friction_bounds import Friction
from fuzzyarm.proof.tip.laps import LapSet
from fuzzyarm.proof.tip.plant import BallPlant, PlantSet

from .__main__ import main
from .forge import Attack
from .judge import Outcome, attacked, tried
from .sets import drawn_later

SLICE = ((0, 0), (0, 2), (0, 5), (0, 6), (0, 9), (0, 16), (0, 21), (0, 49), (1, 4))
"""By seed and number: (0, 2), (0, 9), (0, 16) begin in a box, (0, 5) is a later lap, (0, 49) has a guest."""


def outcome_of(claim, later=None, plans="own", division=1):
    attack = Attack(plans, "own", "least", division)
    return attacked(Outcome(0, 0, claim, attack, later), np.random.default_rng(0))


@pytest.mark.parametrize(("seed", "number"), SLICE)
def test_no_plant_leaves_a_tube_that_is_accepted(seed, number):
    outcome = tried(seed, number)
    assert outcome.accepted and not outcome.finding, outcome.finding
    assert max(outcome.ratios.values()) > 0.1  # the plants do not stay in the middle of it


SMALL = {"stiffness": (0.99, 1.01), "mass": (0.998, 1.002), "damping": (0.9, 1.1), "motor_inertia": (0.995, 1.005)}


@pytest.mark.parametrize(
    ("plants", "case", "least"),
    [
        (PlantSet(), "nominal", 0.9),  # one plant: its tube is narrow
        (PlantSet(late=1, **SMALL), "nominal", 0.1),
        (PlantSet(viscous_friction=(0.9, 1.1)), "nominal", 0.1),
        (PlantSet(force_course=3.0), "nominal", 0.2),
        (PlantSet(force_swing=0.1), "machining", 0.5),
        (PlantSet(noise=(1e-5, 1e-3)), "nominal", 0.1),
        (PlantSet(), "shield", 0.5),
    ],
    ids=["one plant", "late", "columns", "any force", "swinging force", "encoder errors", "guest"],
)
def test_plants_of_a_set_are_in_its_tube_and_fill_it(plants, case, least):
    policy = "shield:fuzzy-4-tip:any:0.4,0.2" if case == "shield" else "fuzzy-4-tip"
    claim = TipClaim(policy, "nominal" if case == "shield" else case, plants=plants, steps=15)
    outcome = outcome_of(claim)
    assert outcome.accepted > 10 and not outcome.finding, outcome.finding
    assert outcome.ratios["tip"] > least, outcome.ratios


INERTIA = TipClaim("computed-torque-tip", plants=PlantSet(motor_inertia=(0.5, 1.5), dry_friction=(0.0, 0.0)), steps=2)
FORCE = TipClaim("fuzzy-4-tip", "machining", plants=PlantSet(force=(0.0, 0.2)), steps=2)
LIGHT = TipClaim("fuzzy-4-tip", plants=PlantSet(dry_friction=(0.02, 0.04)), steps=3)


def without_constants(monkeypatch):
    """A motor's acceleration without the torques of uncertain constants."""
    pull = Friction.pull
    monkeypatch.setattr(Friction, "pull", lambda self, net, constants, products: pull(self, net, 0.0, 0.0))


def without_products(monkeypatch):
    """Nothing of uncertain constants times the deviation."""
    monkeypatch.setattr(BallPlant, "half", lambda self, kind: [0.0, 0.0])


def force_of_the_middle(monkeypatch):
    """An uncertain force that is relative to its middle twice."""
    whole = BallPlant.of

    def of(parameters, disturbance, plants):
        made, middle = whole(parameters, disturbance, plants), 0.5 * sum(plants.force)
        constants = [dataclasses.replace(p, half=p.half * middle) if p.kind == "force" else p for p in made.parameters]
        return dataclasses.replace(made, parameters=tuple(constants))

    monkeypatch.setattr(BallPlant, "of", of)


def without_share(monkeypatch):
    """Velocities that part by net torques alone, whatever the friction factor."""
    monkeypatch.setattr(Friction, "driving", lambda self, net, constants, products: net + 1e-9)


FAULTS = [
    (without_constants, INERTIA, "monotone"),
    (without_products, INERTIA, "mixed"),
    (force_of_the_middle, FORCE, "own"),
    (without_share, LIGHT, "monotone"),
]


@pytest.mark.parametrize(("fault", "claim", "plans"), FAULTS)
def test_a_fault_of_the_proof_is_found(fault, claim, plans, monkeypatch):
    assert not outcome_of(claim, plans=plans, division=2).finding
    fault(monkeypatch)
    finding = outcome_of(claim, plans=plans, division=2).finding
    assert finding.startswith("exceeded: ") and "the checker says PROVEN" in finding


def test_a_lap_that_forgets_what_the_constants_did_is_found(monkeypatch):
    claim = TipClaim("fuzzy-4-tip", plants=PlantSet(stiffness=(0.99, 1.01)), steps=3)
    later = drawn_later(claim, np.random.default_rng(0))
    outcome = outcome_of(claim, later)
    assert outcome.accepted == 3 and not outcome.finding and outcome.ratios["column"] > 0.9
    whole = LapSet.deviations

    def forgetful(self):
        made = whole(self)
        made.columns[:, : self.constants.shape[1]] = 0.0
        return made

    monkeypatch.setattr(LapSet, "deviations", forgetful)
    assert outcome_of(claim, later).finding.startswith("exceeded: ")


def test_the_command_keeps_figures_and_a_finding_is_made_again(tmp_path, monkeypatch, capsys):
    without_constants(monkeypatch)
    out = tmp_path / "tip_fuzz.json"
    monkeypatch.setattr(sys, "argv", ["tip_fuzz", "--minutes", "0", "--first", "21", "--json", str(out)])
    assert main() == 1
    assert "seed 0, try 21: exceeded: tube" in capsys.readouterr().out
    document = json.loads(out.read_text())
    assert (document["tries"], document["accepted"], len(document["findings"])) == (1, 1, 1)
    assert document["command"] == "python -m tests.tip_fuzz --minutes 0 --seed 0 --first 21"
    assert sum(part["tries"] for part in document["by"]["plans"].values()) == 1
    assert {"commit", "machine", "versions", "seconds", "tip", "tube", "column"} <= document.keys()
    monkeypatch.setattr(sys, "argv", ["tip_fuzz", "--seed", "0", "--only", "21"])
    assert main() == 1
    monkeypatch.undo()
    assert not tried(0, 21).finding
