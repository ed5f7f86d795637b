"""Forged bounds are refused for the bound, beside a true twin that is accepted: a change of format is no refusal."""

import dataclasses

import pytest
from support.forged_bounds import Understated, checked, with_part

from fuzzyarm.policies.tip_bound import TipClaim, find_bound
from fuzzyarm.proof.tip.centre import Mode
from fuzzyarm.proof.tip.friction_bounds import Plan
from fuzzyarm.proof.tip.plant import PlantSet
from fuzzyarm.proof.tip.transition import layout

STEPS, AT = 8, 5
LEFT, LARGER = "may leave the claimed tube, in row", "a bound on the tip error is larger"
FRICTION = "contradicts the friction plan of motor"
PLANTS = PlantSet(
    mass=(0.998, 1.002), motor_inertia=(0.995, 1.005), stiffness=(0.99, 1.01), damping=(0.95, 1.05),
    dry_friction=(0.9, 1.1), viscous_friction=(0.9, 1.1), payload=(0.0, 0.01), force=(0.99, 1.01), force_swing=0.01,
    force_course=0.1, noise=(1e-7, 1e-5),
)  # fmt: skip


@pytest.fixture(scope="module")
def true():
    return find_bound(TipClaim("fuzzy-4-tip", "machining", plants=PLANTS, steps=STEPS))


@pytest.fixture(scope="module")
def twin(true, tmp_path_factory):
    """The true file: written in the same way, it is accepted."""
    path = tmp_path_factory.mktemp("true") / "bound.json"
    answer = checked(true, path)
    assert answer.proven and answer.reason == "" and answer.bound == true.largest
    return path


def narrowed(row):
    """Each of the tube's rows is needed: without one of them a file could claim what it likes."""

    def narrow(segment, closed):
        tube = closed.tube.copy()
        tube[row] *= 0.9
        return segment, dataclasses.replace(closed, tube=tube)

    return lambda true: with_part(true, AT, narrow)


def planned(plan):
    return lambda true: with_part(
        true, AT, lambda part, closed: (part, dataclasses.replace(closed, plans=(plan, plan)))
    )


def centred(change):
    return lambda true: with_part(true, AT, lambda part, closed: (part._replace(**change(part)), closed))


def claimed(**change):
    return lambda true: dataclasses.replace(true, claim=dataclasses.replace(true.claim, **change))


def a_smaller_number(true):
    smaller = true.tip.copy()
    smaller[AT] *= 1.0 - 1e-6
    assert smaller.max() == true.tip.max()
    return dataclasses.replace(true, tip=smaller)


def understated(true):
    return Understated(**{field.name: getattr(true, field.name) for field in dataclasses.fields(true)})


WIDER = {
    "mass": (0.99, 1.01), "motor_inertia": (0.9, 1.1), "stiffness": (0.9, 1.1), "damping": (0.5, 1.5),
    "dry_friction": (0.5, 1.5), "viscous_friction": (0.0, 2.0), "payload": (0.0, 0.1), "force": (0.9, 1.1),
    "force_swing": 0.1, "force_course": 1.0, "noise": (1e-6, 1e-4), "friction": "any", "late": 1,
}  # fmt: skip
MOTIONS = {"policy": "fuzzy-1", "case": "nominal", "path": "lemniscate", "duration": 1.4}
OF_A_SET = (LEFT, LARGER, FRICTION, "a friction plan of the file assumes a friction law", "may reach its torque limit")
OF_A_CENTRE = (LEFT, LARGER, FRICTION)
FORGED = {
    **{f"a narrower row {k + 1}": (narrowed(k), f"{LEFT} {k + 1}") for k in range(layout(2, 2).row_count)},
    "one smaller number of the tip": (a_smaller_number, LARGER),
    "smaller numbers of the tip": (lambda true: dataclasses.replace(true, tip=0.5 * true.tip), LARGER),
    "a smaller bound": (understated, "the tip error may reach"),
    **{
        f"a wider {name}": (claimed(plants=dataclasses.replace(PLANTS, **{name: wider})), *OF_A_SET)
        for name, wider in WIDER.items()
    },
    **{f"another {name}": (claimed(**{name: other}), LEFT, LARGER) for name, other in MOTIONS.items()},
    "the case payload": (claimed(case="payload"), LEFT, LARGER),
    "motors held": (planned(Plan.HELD), FRICTION),
    "motors that slip": (planned(Plan.SLIP), FRICTION),
    "other modes": (centred(lambda _: {"modes": (Mode.FORWARD, Mode.FORWARD)}), *OF_A_CENTRE),
    "another end": (centred(lambda part: {"end": part.end + 1e-3}), *OF_A_CENTRE),
    "another centre": (centred(lambda part: {"angles": part.angles + 1e-6}), *OF_A_CENTRE),
    "a shorter part": (
        centred(lambda part: {"duration": 0.5 * part.duration}), "the segments of control step 6 last", LEFT,
    ),
    "a missing step": (
        lambda true: dataclasses.replace(true, steps=(*true.steps[:AT], *true.steps[AT + 1 :])),
        LEFT, LARGER, "ends before the motion",
    ),
    "a missing end": (
        lambda true: dataclasses.replace(true, steps=true.steps[:AT]), "the file ends before the motion does",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", FORGED)
def test_a_forged_bound_is_refused_for_what_is_wrong(true, twin, tmp_path, name):
    forge, *reasons = FORGED[name]
    answer = checked(forge(true), tmp_path / "forged.json")
    assert not answer.proven and any(reason in answer.reason for reason in reasons), answer.reason
    assert (tmp_path / "forged.json").read_text() != twin.read_text()
