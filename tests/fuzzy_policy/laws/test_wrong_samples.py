"""Readings that are no numbers, and states that are none: refused in one line, and the state that there was goes on."""

import copy
import dataclasses

import numpy as np
import pytest
from slow_twins import slow_but
from support.results import identical

from fuzzyarm import load_policy
from fuzzyarm.envs.observation import Observation
from fuzzyarm.fuzzy_policy.laws.adaptive.policy import AdaptiveObserverPolicy

ALL = ["fuzzy-4", "fuzzy-4-tip", "computed-torque", "elastic-observer", "adaptive-observer", "learned-observer"]
SEEN = np.array([[0.3, 0.5, 0.0, 0.0, 0.3001, 0.5002, 0.1, -0.1, 0.2, 0.3]] * 2) + 1e-4 * np.arange(4)[:, None, None]
ADAPTIVE = AdaptiveObserverPolicy()


def torques(policy, between=lambda policy, state: None):
    """Torques of two lanes at the samples of SEEN, with something in between."""
    state, found = None, []
    for seen in SEEN:
        torque, state = policy.predict(seen, state)
        found.append(torque)
        between(policy, state)
    return np.array(found)


def refused(policy, state):
    """Give every kind of bad sample, in every entry."""
    for entry in range(10):
        for number in (np.nan, np.inf, -np.inf):
            bad = SEEN[0].copy()
            bad[1, entry] = number
            part = f"{Observation._fields[entry // 2]} of joint {entry % 2 + 1}"
            said = (
                rf"observation\[1, {entry}\] = {number} \({part}\) is not finite; apply the last torques again and keep"
            )
            with pytest.raises(ValueError, match=f"^{said} the state$"):
                policy.predict(bad, state)
    if np.shape(state) == (2, 2):
        return  # a law of one integral answers any number with a torque at the limit
    huge = SEEN[0].copy()
    huge[1, 7] = 1e300
    parts = vars(state) if dataclasses.is_dataclass(state) else {"memory": state}
    before = copy.deepcopy(parts)
    with pytest.raises(ValueError, match=r"^the policy returns no finite torque, .* has magnitude 1e\+300"):
        policy.predict(huge, state)
    assert identical(parts, before)


SIZE = ADAPTIVE.memory_size
PASSES, LEARNING = ADAPTIVE.repeated(), load_policy("fuzzy-4-tip").repeated()


@pytest.mark.parametrize(
    "policy", [*slow_but(["fuzzy-4-tip", "elastic-observer", "adaptive-observer"], ALL), PASSES, LEARNING]
)
def test_after_a_reading_from_which_no_torque_follows_the_state_goes_on_as_if_it_had_not_been(policy):
    policy = load_policy(policy) if isinstance(policy, str) else policy
    np.testing.assert_array_equal(torques(policy, refused), torques(policy))


def test_what_is_no_state_is_refused_by_name():
    passes, learning = PASSES.predict(SEEN[0])[1], LEARNING.predict(SEEN[0])[1]
    small, needs = dataclasses.replace(passes, memory=np.zeros((2, 7))), "must be the PassState"
    for use, state, message in (
        (ADAPTIVE.beliefs, ["a"], rf"= \['a'\] must be real numbers of shape \(..., {SIZE}\)"),
        (ADAPTIVE.beliefs, np.zeros(3), rf"has shape \(3,\); allowed: \(..., {SIZE}"),
        (PASSES.beliefs, None, f"= None {needs}"),
        (PASSES.begin_pass, np.zeros(3), rf"= array\(\[0., 0., 0.\]\) {needs} returned by predict or begin_pass"),
        (PASSES.begin_pass, learning, needs),
        (PASSES.begin_pass, small, f"has a memory of 7 numbers, not {SIZE}; use"),
        (lambda state: PASSES.predict(SEEN[0], state), np.zeros((2, SIZE)), needs),
        (LEARNING.begin_pass, None, "= None must be the LearnedTorque returned by predict"),
        (
            lambda state: LEARNING.predict(SEEN[0, 0], state),
            learning,
            "is for 2 environment.*, observation for 1; give",
        ),
    ):
        with pytest.raises((TypeError, ValueError), match=f"^state .*{message}") as caught:
            use(state)
        assert "\n" not in str(caught.value)
    with pytest.raises(ValueError, match=r"^observation\[3\] = nan \(dq_motor of joint 2\) is not finite"):
        ADAPTIVE.predict(np.where(np.arange(10) == 3, np.nan, SEEN[0, 0]))
