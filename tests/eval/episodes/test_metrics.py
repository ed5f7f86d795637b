"""Each metric on signals whose answer is known."""

import dataclasses

import numpy as np
import pytest
from support.rollouts import made_rollout

from fuzzyarm.eval.episodes.metrics import METRICS, add_metric, metrics_of

N = 1000
T = 1e-3


def signals(**changes):
    return made_rollout(T * np.arange(1, N + 1), **changes)


def test_all_zero_signals_give_zero_but_for_the_margin_and_the_time():
    values = metrics_of(signals())
    assert values.pop("domain_margin") == 1.0
    assert values.pop("predict_us") == pytest.approx(4.0)
    assert set(values.values()) == {0.0}


def test_tip_error_of_a_sine():
    error = 1e-3 * np.abs(np.sin(2 * np.pi * np.arange(N) / N))
    values = metrics_of(signals(tip_error=error))
    assert values["tip_error_max_mm"] == pytest.approx(1.0)
    assert values["tip_error_rms_mm"] == pytest.approx(np.sqrt(0.5))


def test_the_middle_leaves_out_a_tenth_of_a_second_at_either_end():
    error = np.full(N, 1e-3)
    error[:100], error[-100:], error[100], error[-101] = 9e-3, 8e-3, 2e-3, 3e-3
    assert metrics_of(signals(tip_error=error))["tip_error_max_mid_mm"] == pytest.approx(3.0)
    error[-101] = 1e-3
    assert metrics_of(signals(tip_error=error))["tip_error_max_mid_mm"] == pytest.approx(2.0)


def test_circularity_ranges_keep_their_sides_apart():
    link, motor = np.linspace(-2e-3, 6e-3, N), np.linspace(-1e-4, 2e-4, N)
    values = metrics_of(signals(circularity_error=link, circularity_error_motor=motor))
    assert [values[f"circularity_link_{end}_mm"] for end in ("min", "max")] == pytest.approx([-2.0, 6.0])
    assert [values[f"circularity_motor_{end}_mm"] for end in ("min", "max")] == pytest.approx([-0.1, 0.2])


def test_joint_error_is_over_both_joints_and_on_the_motor_side():
    q = np.zeros((N, 2))
    q[:, 0] = 3e-3
    values = metrics_of(signals(q_motor=q, q_link=q + 1.0))
    assert values["joint_error_rms_mrad"] == pytest.approx(3.0 / np.sqrt(2.0))


def test_torque_metrics_of_a_ramp():
    torque = np.stack([np.linspace(0, 99.9, N), -np.full(N, 7.0)], axis=1)
    values = metrics_of(signals(torque=torque))
    assert values["torque_peak_1"] == pytest.approx(99.9)
    assert values["torque_peak_2"] == 7.0
    assert values["torque_rms_2"] == pytest.approx(7.0)
    # Joint 1 climbs 0.1 N m a step, joint 2 not at all.
    assert values["torque_rate_rms"] == pytest.approx(100.0 / np.sqrt(2.0))


def test_energy_counts_braking_as_work_too():
    speed = np.stack([np.sin(2 * np.pi * np.arange(N) / N), np.zeros(N)], axis=1)
    values = metrics_of(signals(torque=np.full((N, 2), 10.0), dq_motor=speed))
    assert values["energy"] == pytest.approx(10.0 * 2.0 / np.pi, rel=1e-5)


def test_an_episode_of_one_step_has_metrics():
    assert np.isfinite(list(metrics_of(made_rollout(np.array([T]))).values())).all()


def test_every_metric_says_what_it_is_and_a_name_that_is_taken_is_refused():
    for name, metric in METRICS.items():
        assert metric.name == name
        assert metric.description.endswith(".")
        assert name.endswith({"mm": "_mm", "mrad": "_mrad", "µs": "_us"}.get(metric.unit, ""))
    assert [name for name, metric in METRICS.items() if not metric.reproducible] == ["predict_us"]
    with pytest.raises(ValueError, match="there is a metric 'energy' already"):
        add_metric(dataclasses.replace(METRICS["energy"], unit="kJ"))
