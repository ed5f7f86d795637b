"""A law so simple that its loop is known."""

import numpy as np


class Springs:
    """u = (60, 20) N m - 2e4 e - 400 ė, with a memory and a precision given by the test."""

    def __init__(self, memory=None, dtype=np.float64):
        self.memory, self.dtype = memory, dtype

    def predict(self, observation, state=None, *_, **__):
        e = observation[..., :4] - observation[..., 4:8]
        torque = np.array([60.0, 20.0]) - 2e4 * e[..., :2] - 400.0 * e[..., 2:]
        return torque.astype(self.dtype), self.memory(observation, state) if self.memory else None

    def without_dry_friction(self):
        return self
