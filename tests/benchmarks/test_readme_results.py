"""The README's column of proofs: only stored rows that are proven, and which set of arms each is for."""

import pytest

CIRCLE = {"case": "nominal", "path": "circle", "duration": 1.5, "proven": True}


def bound(policy, name, millimetres, payload=0.0, **others):
    row = {"policy": policy, "set": name, "bound_mm": millimetres, "plants": {"payload": [0.0, payload]}}
    return {**CIRCLE, **row, **others}


@pytest.fixture
def words(module):
    """Return what is proven of a policy, given rows of bounds."""

    def words(*rows, certificates=None):
        return module("readme_results")._proven({"certificates": certificates or {"a": None}}, {"rows": rows})["a"]

    return words


def test_bounds_for_arms_nearby_are_shown_and_that_for_one_arm_is_labelled_or_left_out(words):
    exact, near = bound("a", "table-1", 0.00226), bound("a", "near", 0.6747)
    assert words(exact) == "tip within 0.0023 mm (exact)"
    assert words(exact, near) == words(near, exact) == "tip within 0.68 mm (near)"
    loads = [bound("a", f"payload 0 to {load:g} kg", load, load) for load in (5.0, 0.2)]
    assert words(exact, *loads, near, bound("a", "any-friction", 0.97)) == (
        "tip within 0.68 mm (near), 0.97 mm (any friction), 5 mm (payload 0 to 5 kg)"
    )


@pytest.mark.parametrize(
    "others", [{"proven": False}, {"case": "payload"}, {"path": "lemniscate"}, {"duration": 1.2}, {"policy": "b"}]
)
def test_what_is_not_proven_or_of_another_motion_is_not_shown(words, others):
    assert words(bound("a", "near", 0.5) | others) == "no"


def test_the_rigid_arm_is_named_apart(words):
    row = bound("a", "near", 0.5)
    assert words(row, certificates={"a": "For the rigid arm ..."}) == "rigid arm; tip within 0.5 mm (near)"


def test_below_a_micrometre_the_table_gives_no_number_and_above_it_two_digits(module):
    errors = {"nominal": (0.00042, 0.00226), "machining": (4.98, 10.8), "payload": (0.00101, 0.000999)}
    results = [
        {"policy": "a", "case": case, "tip_error_rms_mm": rms, "tip_error_max_mm": largest}
        for case, (rms, largest) in errors.items()
    ]
    versions = dict.fromkeys(("python", "numpy", "llvmlite", "clarabel"), "1")
    made = {"versions": versions, "machine": {"cpu": "x", "cores": 2}, "commit": "c"}
    text = module("readme_results").overview_table(
        {"results": results, "certificates": {"a": None}, **made}, {"rows": [], "command": "y"}
    )
    assert "| a | < 0.001 / 0.0023 | 5.0 / 11 | 0.0010 / < 0.001 | no |" in text
