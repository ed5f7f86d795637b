"""`learned-observer` is its equations, of the arm of Table 1 and of robots, and its folder holds data only."""

import dataclasses

import numpy as np
import pytest
from scipy.special import expit
from slow_twins import slow_but
from support.bundles import estimate_network
from support.plain import observer_law
from support.policies import remembered

from fuzzyarm import ArmParameters, Robot, load_policy, robot_named
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.observation import observed
from fuzzyarm.envs.physics import rigid_body
from fuzzyarm.envs.physics.dynamics import arm_constants, tip_jacobian
from fuzzyarm.envs.physics.equations import equations_of, robot_of, two_joints
from fuzzyarm.envs.physics.records import PerJoint, State, filled
from fuzzyarm.eval.stability.margins import policy_margins
from fuzzyarm.fuzzy_policy.known_arm import _constants_of as constants_of
from fuzzyarm.fuzzy_policy.laws._elastic_target import ElasticTarget
from fuzzyarm.fuzzy_policy.laws.adaptive.belief import FLAG, AdaptiveWeights
from fuzzyarm.fuzzy_policy.laws.adaptive.filter import Scratch, correct, predict
from fuzzyarm.fuzzy_policy.laws.adaptive.policy import AdaptiveObserverPolicy
from fuzzyarm.fuzzy_policy.laws.adaptive.regulator import act
from fuzzyarm.fuzzy_policy.laws.elastic_observer import ElasticObserverPolicy
from fuzzyarm.fuzzy_policy.laws.learned.definition import ArmDefinition
from fuzzyarm.fuzzy_policy.laws.learned.estimate.policy import LearnedObserverPolicy
from fuzzyarm.fuzzy_policy.laws.learned.estimate.rnn import EstimateBundle
from fuzzyarm.fuzzy_policy.laws.learned.estimate.signals import context_of, context_parts, scale_of, turns_of, units_of

ARM, PLANAR, PERIOD, HIDDEN = ArmParameters(), robot_named("planar-3r"), 1e-3, 7


@pytest.fixture(scope="module")
def policy():
    return LearnedObserverPolicy(estimate_network())


def context(arm, o, feedforward):
    """The parts of c that the arm decides, in their order, and the last one: whether the tip moves."""
    (q, _, _, dq, ddq), units, psi = np.split(o, 5), units_of(arm), []
    jacobian = tip_jacobian(q, ARM.length) if arm is ARM else rigid_body.tip_jacobian(arm, q)
    velocity = jacobian @ dq
    square = velocity @ velocity
    travel = velocity / np.sqrt(square + units.slow_tip**2)
    for angle, turn in zip(q, turns_of(arm), strict=True):
        psi.append(angle + (turn * psi[-1] if turn else 0.0))
    angles, limit = np.ravel([np.cos(psi), np.sin(psi)], order="F"), robot_of(arm).drive("torque_limit")
    scaled = dq / units.velocity, ddq / units.acceleration, feedforward / limit, dq / np.sqrt(dq**2 + units.slow**2)
    c = np.concatenate([angles, *scaled, travel, jacobian.T @ travel / units.length])
    return c, square / (square + units.rest**2)


class Oracle:
    """The equations of `policy`, `network` and `signals` in plain NumPy, for one arm."""

    def __init__(self, made):
        self.n, self.observer = made, ElasticObserverPolicy(ARM, PERIOD)
        adaptive = AdaptiveObserverPolicy(ARM, PERIOD, AdaptiveWeights(first_gain=1.0, scale_doubt=3e-3))
        self.settings, self.filter = adaptive.settings, np.zeros(adaptive.memory.noise.stop)
        self.target, self.h, self.rho, self.predicted = ElasticTarget(ARM, PERIOD), np.zeros(HIDDEN), np.zeros(2), None
        self.target_memory = np.zeros((1, self.target.memory_size))

    def beliefs(self, m):
        """The shares of the loads in z, and of the trust in c."""
        load = (m.z[8:] - self.settings.guess)[:4] / [20.0, 20.0, 20.0, 1.0]
        surprise, noise = m.flags[FLAG.surprise], np.sqrt(m.noise.max())
        trust = m.z[-1], np.sqrt(m.P[-1, -1]), m.flags[FLAG.calm], np.arcsinh(surprise), np.arcsinh(noise / 1e-6) / 3.0
        return np.arcsinh(load), np.array(trust)

    def residual(self, innovations, load, gap, belief, c):
        """The share by which the adaptive observer is followed; h and ρ follow."""
        n, units = self.n, np.array([[5e-7, 2e-6, 1e-3, 4e-3], [1e-5, 4e-5, 2e-2, 8e-2]])
        scaled = []
        for innovation in innovations:
            fine, coarse = np.arcsinh(innovation / units)
            scaled += [fine, coarse * innovation**2 / (innovation**2 + units[0] ** 2)]
        torques = np.array([600.0, 300.0])
        z = np.concatenate([*scaled, load / torques, np.arcsinh(gap / (0.05 * torques)), self.rho, belief])
        gates = expit(n.gate_z @ z + n.gate_h @ self.h + n.gate_c @ c + n.gate_bias)
        s, r = gates[:HIDDEN], gates[HIDDEN:]
        candidate = np.tanh(n.A @ z + (n.C @ c) * (n.B @ z) + r * (n.U @ self.h))
        self.h = self.h + s * (candidate - self.h)
        weights = 1.0 + n.W @ np.tanh(n.P @ c + n.p_0)
        size = np.sum((load / torques) ** 2)
        share = c[-1] * size / (size + 600.0**-2)
        beyond = (n.G @ (self.h * weights)) * gap / torques
        self.rho = np.clip(share * (n.V @ (self.h * weights) + beyond + n.D @ z), -1.0, 1.0)
        return share

    def step(self, o, applied):
        """The torque; `applied` is what the motors apply: without it rounding would grow from sample to sample."""
        desired, feedforward = np.empty((1, 6)), np.empty((1, 2))
        self.target.advance(o[np.newaxis], self.target_memory, desired, feedforward)
        if self.predicted is None:
            q, constants = o[:2].copy(), arm_constants(ARM)
            for _ in range(20):
                q = o[:2] - np.array(two_joints().gravity(PerJoint(*q), constants)) / ARM.stiffness
            self.predicted = np.concatenate([o[:2], q, o[2:4], o[2:4], np.zeros(2)])
        m, room, u_a = remembered(self.filter, two_joints()), Scratch(two_joints(), self.settings), np.empty(2)
        innovation = (o[:4] - m.z[[0, 1, 4, 5]]) * (m.flags[FLAG.samples] > 0)
        correct(m, self.settings, room, observed(o))  # called as they are: not compiled
        act(room.acted, m, self.settings, room, u_a)
        estimate, u = observer_law(self.observer, o, self.predicted, desired[0], feedforward[0])
        (belief, trust), gap, (c, moving) = self.beliefs(m), u_a - u, context(ARM, o, feedforward[0])
        innovations = innovation, o[:4] - self.predicted[[0, 1, 4, 5]]
        share = self.residual(innovations, estimate[8:], gap, belief, np.concatenate([c, trust, [moving]]))
        u = np.clip(u + share * gap + self.rho * [600.0, 300.0], -np.array(ARM.torque_limit), ARM.torque_limit)
        m.commands[0] = applied
        predict(m, self.settings, room, u_a)
        self.predicted = self.predict(estimate, applied)
        return u

    def predict(self, estimate, u):
        state, load = State(*(PerJoint(*pair) for pair in estimate[:8].reshape(4, 2))), PerJoint(*estimate[8:])
        for _ in range(5):
            state = two_joints().loaded_step(state, PerJoint(*u), load, arm_constants(ARM), PERIOD / 5)
        return np.concatenate([np.ravel(state), estimate[8:]])


def test_the_policy_is_its_equations(policy):
    env, oracle, memory = FuzzyArmEnv("machining"), Oracle(policy.network), None
    observation, _ = env.reset(seed=0)
    sizes = []
    for _ in range(25):
        torque, memory = policy.predict(observation, memory)
        np.testing.assert_allclose(torque, oracle.step(observation, torque), rtol=1e-9, atol=1e-8)
        sizes.append(np.abs(oracle.rho).max())
        observation = env.step(torque)[0]
    assert 0.005 < max(sizes) < 1.0  # the network acts, and is not clipped


@pytest.mark.parametrize("swings", [False, True])
def test_where_the_filter_has_diverged_or_commands_swing_the_elastic_observer_acts_alone(policy, swings):
    observer, env, apart = ElasticObserverPolicy(ARM, PERIOD), FuzzyArmEnv("payload"), []
    for given_up in (False, True):
        (observation, _), memory, own = env.reset(seed=0), None, None
        for k in range(30):
            expected, memory = observer.predict(observation, memory)
            torque, own = policy.predict(observation, own)
            assert policy.beliefs(own).diverged == (given_up and k > 0)
            if given_up and swings:
                own[policy.filter.start + FLAG.swing] = 1.0  # the law sees that at its next sample
            elif given_up:
                own[policy.filter.start + FLAG.lost] = 1.0
                own[policy.filter][policy.adaptive.memory.z] = np.nan
            apart.append(np.abs(torque - expected).max())
            observation = env.step(torque)[0]
    assert min(apart[5:30]) > 0.01 and max(apart[31:]) == 0.0  # N m


@pytest.mark.parametrize("arm", slow_but([ARM], [ARM, PLANAR]), ids=["paper", "planar-3r"])
def test_a_lane_of_a_batch_is_the_single_arm_and_at_rest_it_is_the_elastic_observer_bit_for_bit(arm):
    n = 2 if arm is ARM else 3
    policy, observer = LearnedObserverPolicy(estimate_network(n, n), arm, PERIOD), ElasticObserverPolicy(arm, PERIOD)
    generator, states, batch_state = np.random.default_rng(1), [None] * 5, None
    for _ in range(10):
        observations = generator.normal(size=(5, 5 * n))
        batch, batch_state = policy.predict(observations, batch_state, np.zeros(5, dtype=bool))
        for lane in range(5):
            single, states[lane] = policy.predict(observations[lane], states[lane])
            assert single.tobytes() == batch[lane].tobytes()
            assert states[lane].tobytes() == batch_state[lane].tobytes()
    posture, memory, own = np.array([0.6, 1.2, 0.5])[:n], None, None
    rest = np.concatenate([posture, np.zeros(n), posture, np.zeros(2 * n)])
    for _ in range(20):
        read = rest + np.concatenate([1e-4 * generator.normal(size=2 * n), np.zeros(3 * n)])
        expected, memory = observer.predict(read, memory)
        torque, own = policy.predict(read, own)
        assert torque.tobytes() == expected.tobytes()


def test_a_bundle_comes_back_and_is_loaded_by_its_folder_for_its_arm_and_period_alone(policy, tmp_path):
    record = {"training": {"chunks": 3}, "seed": 2, "curve": [{"loss": 1.0}], "versions": {"numpy": "2"}}
    folder, robots = tmp_path / "mine", tmp_path / "robots"
    EstimateBundle(estimate_network(), ARM, PERIOD, **record).save(folder)
    torque, expected = (one.predict(np.linspace(0.1, 1.0, 10))[0] for one in (load_policy(folder), policy))
    assert torque.tobytes() == expected.tobytes()
    assert EstimateBundle.load(folder).seed == 2
    EstimateBundle(estimate_network(3, 3), ArmDefinition(PLANAR.name, PLANAR.digest), PERIOD).save(robots)
    assert EstimateBundle.load(robots).serves(dataclasses.replace(PLANAR, name="the same numbers"))
    others = "ur5", "paper", dataclasses.replace(PLANAR, gravity=(9.8, 0.0, 0.0))
    words = "robots was trained on planar-3r and works only on it; use that arm"
    for path, given, message in (
        (folder, {"robot": ArmParameters(mass=(15.0, 8.0))}, "was trained on the arm of Table 1"),
        (folder, {"control_period": 2e-3}, r"trained for control_period = 0.001 s, not 0.002 s"),
        *((robots, {"robot": robot}, words) for robot in others),
    ):
        with pytest.raises(ValueError, match=message):
            load_policy(path, **given)


def test_units_of_a_robot_are_those_of_the_same_arm_and_angles_add_about_parallel_axes():
    assert scale_of(Robot.of(ARM)) == scale_of(ARM) == (1.0, 1.0, 1.0)
    known = {"velocity": 3.0, "acceleration": 30.0, "slow": 0.05, "slow_tip": 0.02, "rest": 1e-4, "length": 1.0}
    for name, value in known.items():
        np.testing.assert_array_equal(getattr(units_of(ARM), name), value)
    for name in ("torque", "load", *known):
        np.testing.assert_allclose(*(getattr(units_of(arm), name) for arm in (Robot.of(ARM), ARM)), rtol=1e-12)
    assert units_of(PLANAR).slow_tip == 0.02 * scale_of(PLANAR).length == 0.02 * units_of(PLANAR).length
    for arm, turns in ((ARM, [0, 1]), (Robot.of(ARM), [0, 1]), (robot_named("ur5"), [0, 0, 1, 1, 0, 0])):
        np.testing.assert_array_equal(turns_of(arm), turns)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["planar-3r", "ur5"])
def test_the_context_of_a_robot_is_its_equations(name):
    robot = robot_named(name)
    joints, physics, generator = len(robot), equations_of(robot), np.random.default_rng(0)
    part, o, feedforward = context_parts(joints, 3), generator.normal(size=5 * joints), generator.normal(size=joints)
    c, limit, arm = np.empty(part.motion.stop), robot.drive("torque_limit"), filled(physics.Arm, constants_of(robot))
    context_of(physics)(observed(o), feedforward, limit, turns_of(robot), arm, units_of(robot), c)
    expected = np.append(*context(robot, o, feedforward))
    np.testing.assert_allclose(np.append(c[: part.lever.stop], c[part.motion]), expected, atol=1e-12)


@pytest.mark.slow
def test_the_margins_of_a_robot_are_the_elastic_observers():
    policies = LearnedObserverPolicy(estimate_network(3, 3), PLANAR, PERIOD), ElasticObserverPolicy(PLANAR, PERIOD)
    own, base = (policy_margins(one, PLANAR, PERIOD)["spectral_radius"]["nominal"] for one in policies)
    assert own == base
    with pytest.raises(ValueError, match="for 6 joints and a tip with 3 coordinates, but the arm has 3 joints and"):
        LearnedObserverPolicy(estimate_network(6, 3), PLANAR, PERIOD)
