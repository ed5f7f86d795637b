"""Forged bounds are refused for the bound, beside a true twin that is accepted: a change of format is no refusal.

Every file here is written by `save_bound`, so that each is well formed in the format of the day, and every refusal
names what is wrong with the tube, the tip or the motion.
"""

import dataclasses

import pytest
from support.forged_bounds import Understated, checked, with_part

from fuzzyarm.policies.tip_bound import TipClaim, find_bound
from fuzzyarm.proof.tip.centre import Mode
from fuzzyarm.proof.tip.friction_bounds import Plan
from fuzzyarm.proof.tip.plant import PlantSet
from fuzzyarm.proof.tip.transition import layout

STEPS, AT = 8, 5
LEFT, LARGER, ERRS = (
    "may leave the claimed tube, in row",
    "a bound on the tip error is larger",
    "the tip error may reach",
)
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


def refused(bound, twin, path, *reasons):
    answer = checked(bound, path)
    assert not answer.proven and any(reason in answer.reason for reason in reasons), answer.reason
    assert path.read_text() != twin.read_text()


@pytest.mark.parametrize("row", range(layout(2, 2).row_count))
def test_a_narrower_tube(true, twin, tmp_path, row):
    """Each of the tube's rows is needed: without one of them a file could claim what it likes."""

    def narrow(segment, closed):
        tube = closed.tube.copy()
        tube[row] *= 0.9
        return segment, dataclasses.replace(closed, tube=tube)

    refused(with_part(true, AT, narrow), twin, tmp_path / "forged.json", f"{LEFT} {row + 1}")


def test_smaller_numbers_of_the_tip(true, twin, tmp_path):
    smaller = true.tip.copy()
    smaller[AT] *= 1.0 - 1e-6
    assert smaller.max() == true.tip.max()
    refused(dataclasses.replace(true, tip=smaller), twin, tmp_path / "one.json", LARGER)
    refused(dataclasses.replace(true, tip=0.5 * true.tip), twin, tmp_path / "all.json", LARGER)


def test_a_smaller_bound(true, twin, tmp_path):
    fields = {field.name: getattr(true, field.name) for field in dataclasses.fields(true)}
    refused(Understated(**fields), twin, tmp_path / "forged.json", ERRS)


WIDER = {
    "mass": (0.99, 1.01), "motor_inertia": (0.9, 1.1), "stiffness": (0.9, 1.1), "damping": (0.5, 1.5),
    "dry_friction": (0.5, 1.5), "viscous_friction": (0.0, 2.0), "payload": (0.0, 0.1), "force": (0.9, 1.1),
    "force_swing": 0.1, "force_course": 1.0, "noise": (1e-6, 1e-4), "friction": "any", "late": 1,
}  # fmt: skip


@pytest.mark.parametrize("name", WIDER)
def test_a_wider_set(true, twin, tmp_path, name):
    """The tube of a set is not one of a wider set, field by field."""
    claim = dataclasses.replace(true.claim, plants=dataclasses.replace(PLANTS, **{name: WIDER[name]}))
    reasons = (
        LEFT,
        LARGER,
        "contradicts the friction plan of motor",
        "a friction plan of the file assumes a friction law",
        "may reach its torque limit",
    )
    refused(dataclasses.replace(true, claim=claim), twin, tmp_path / "forged.json", *reasons)


@pytest.mark.parametrize(
    "change",
    [{"policy": "fuzzy-1"}, {"case": "nominal"}, {"case": "payload"}, {"path": "lemniscate"}, {"duration": 1.4}],
    ids=str,
)
def test_another_motion(true, twin, tmp_path, change):
    claim = dataclasses.replace(true.claim, **change)
    refused(dataclasses.replace(true, claim=claim), twin, tmp_path / "forged.json", LEFT, LARGER)


@pytest.mark.parametrize("plan", [Plan.HELD, Plan.SLIP])
def test_another_plan(true, twin, tmp_path, plan):
    def planned(segment, closed):
        return segment, dataclasses.replace(closed, plans=(plan, plan))

    refused(with_part(true, AT, planned), twin, tmp_path / "forged.json", "contradicts the friction plan of motor")


@pytest.mark.parametrize("change", [{"modes": (Mode.FORWARD, Mode.FORWARD)}, {"end": 1e-3}, {"angles": 1e-6}], ids=str)
def test_another_centre(true, twin, tmp_path, change):
    def moved(segment, closed):
        shifted = {name: value if name == "modes" else getattr(segment, name) + value for name, value in change.items()}
        return segment._replace(**shifted), closed

    refused(
        with_part(true, AT, moved),
        twin,
        tmp_path / "forged.json",
        LEFT,
        LARGER,
        "contradicts the friction plan of motor",
    )


def test_parts_of_the_motion_are_left_out(true, twin, tmp_path):
    def shorter(segment, closed):
        return segment._replace(duration=0.5 * segment.duration), closed

    refused(with_part(true, AT, shorter), twin, tmp_path / "short.json", "the segments of control step 6 last", LEFT)
    missing = dataclasses.replace(true, steps=(*true.steps[:AT], *true.steps[AT + 1 :]))
    refused(missing, twin, tmp_path / "missing.json", LEFT, LARGER, "ends before the motion")
    ended = dataclasses.replace(true, steps=true.steps[:AT])
    refused(ended, twin, tmp_path / "ended.json", "the file ends before the motion does")
