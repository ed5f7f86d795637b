"""Bad input is refused with one clear line, or taken and right: no crash, no hang, no half file, no false PROVEN.

A tenth of the tries of a whole run, always the same ones, as in continuous integration; ABUSE_SHARE is another share.
"""

import os

import pytest

pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")

from .surface import Broken, Surface, Try, try_all
from .surfaces import SURFACES

SHARE = float(os.environ.get("ABUSE_SHARE", "0.1"))


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("surface", SURFACES, ids=lambda surface: surface.name)
def test_nothing_breaks(surface):
    tally = try_all(surface, range(max(1, round(surface.count * SHARE))))
    assert not tally.broken, "\n".join(tally.broken)
    assert tally.tried == tally.refused + tally.accepted


def _judged(run, names=()):
    return try_all(Surface("example", "tests", 1, lambda rng: Try("example", run, names)), range(1)).broken


def test_the_rules_themselves():
    """An error of the package's own is held; foreign errors, several lines and wrong results are not."""
    from fuzzyarm.common import checks

    def foreign():
        return float("x")

    def silent():
        raise Broken("was taken without a word")

    assert not _judged(lambda: checks.real("mass", -1.0, "kg", above=0.0), ("mass",))
    assert not _judged(lambda: None)
    assert _judged(lambda: checks.real("mass", -1.0, "kg", above=0.0), ("length",))
    assert _judged(lambda: checks.real("ma\nss", -1.0, "kg", above=0.0))
    assert _judged(foreign) and _judged(silent) and _judged(lambda: 1 / 0) and _judged(lambda: [][0])


def test_a_try_is_the_same_every_time():
    for surface in SURFACES:
        if surface.group in ("arguments", "environments") and "set_state" not in surface.name:
            first, second = (surface.number(3).what.partition(" at 0x")[0] for _ in range(2))
            assert first == second


def test_the_names_of_surfaces_differ():
    assert len({surface.name for surface in SURFACES}) == len(SURFACES)
