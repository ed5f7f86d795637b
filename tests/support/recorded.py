"""Logs of simulated arms of any number of joints, with encoders and a noisy torque."""

import numpy as np

from fuzzyarm.envs.fastest_mode import fastest_rate
from fuzzyarm.envs.periods import default_substeps
from fuzzyarm.envs.physics.equations import bounds_of, equations_of, robot_of
from fuzzyarm.envs.physics.integrator import force_line, hold_of
from fuzzyarm.envs.physics.records import flat, size
from fuzzyarm.envs.physics.rigid_body import inverse_dynamics
from fuzzyarm.identification.log import Log


def recorded(arm, seed, duration=10.0, period=2e-3, quantum=4e-4, noise=0.02, swing=0.5):
    """Return the log of sums of five sines under computed torque: encoder quantum [rad], torque noise as a share."""
    rng, physics, robot = np.random.default_rng(seed), equations_of(arm), robot_of(arm)
    steps, n, time = round(duration / period), len(robot), np.arange(round(duration / period)) * period
    order = 2.0 * np.pi * 0.12 * np.arange(1, 6)
    phase, height = rng.uniform(0.0, 6.0, (5, n)), swing * rng.normal(size=(5, n)) / np.sqrt(np.arange(1, 6))[:, None]
    angle = order * time[:, np.newaxis]
    reference = np.sin(angle[..., np.newaxis] + phase) - np.sin(phase)
    reference = np.einsum("tkn,kn->tn", reference, height) * np.minimum(1.0, time)[:, np.newaxis]
    rate = np.gradient(reference, period, axis=0)
    change = np.gradient(rate, period, axis=0)
    constants = np.array(flat(physics.constants(physics.plant_of(arm), 0.0, 0.0, 0.0)))[:, np.newaxis].copy()
    hold, force = hold_of(physics), np.zeros((size(force_line(physics.axes)), 1))
    substeps, limit = default_substeps(period, fastest_rate([arm])), bounds_of(arm).torque
    state, rotor = np.zeros((4 * n, 1)), arm.drive("motor_inertia")
    angles, torques = np.empty((2, steps, n))
    stiff, damped = (2.0 * np.pi * 2.0) ** 2, 2.0 * 0.7 * 2.0 * np.pi * 2.0
    for k in range(steps):
        q, dq = np.round(state[:n, 0] / quantum) * quantum, state[2 * n : 3 * n, 0]
        wanted = change[k] + stiff * (reference[k] - q) + damped * (rate[k] - dq)
        torque = np.clip(inverse_dynamics(robot, q, dq, wanted) + rotor * wanted, -limit, limit)
        angles[k], torques[k] = q, torque
        hold(state, torque[:, np.newaxis].copy(), force, constants, period / substeps, substeps)
    assert np.isfinite(angles).all()
    return Log(period, angles, torques + noise * torques.std(axis=0) * rng.normal(size=torques.shape), None, f"s{seed}")
