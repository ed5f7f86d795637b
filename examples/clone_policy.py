"""Behaviour cloning: a network that answers as the policies of a data set did, by regression.

fuzzyarm dataset --out sets --level expert && python examples/clone_policy.py sets/fuzzyarm/expert-nominal-v0

Prints the score N of the cloned policy: in the same episodes computed-torque has 0, learned-observer 100.
docs/tutorials/datasets.md has the scores for four data sets. offline_td3_bc.py learns from the same data with their
rewards.
"""

import argparse
import math
import time

import numpy as np
import torch
from torch import Tensor, nn

from fuzzyarm.envs.observation import JOINTS, observed
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.eval.dataset.store import open_dataset, provenance_of, record, score_of

PAST, WIDTH, BATCH, LEARNING_RATE, FINAL = 4, 128, 512, 1e-3, 0.02
TESTED, TESTED_SEED = {"nominal": 1, "loads": 64}, 2_000_000_000  # episodes (nominal ones are alike), seeds in no data
LIMIT = torch.tensor(ArmParameters().torque_limit)  # N m


def instant(observation: np.ndarray) -> np.ndarray:
    """Return errors of angles and velocities and the reference (..., 10), scaled to a magnitude of about 1."""
    o = observed(observation)
    errors = np.arcsinh(1e3 * (o.q_reference - o.q_motor)), np.arcsinh(50.0 * (o.dq_reference - o.dq_motor))
    reference = o.q_reference, 0.2 * o.dq_reference, 0.02 * o.ddq_reference
    return np.concatenate([*errors, *reference], axis=-1).astype(np.float32)


def with_past(rows: np.ndarray) -> np.ndarray:
    """Return (T, 10 + 4 PAST): each row of an episode (T, 10), and the errors of the rows before it, else zeros."""
    errors = rows[:, : 2 * JOINTS]
    past = [np.concatenate([np.zeros_like(errors[:k]), errors[: len(errors) - k]]) for k in range(1, PAST + 1)]
    return np.concatenate([rows, *past], axis=-1)


class Cloned:
    """A network as a policy; its state is what it remembers of the errors (lanes, 4 PAST)."""

    def __init__(self, network: nn.Module) -> None:
        """Keep the network."""
        self.network = network

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        """Return torques (lanes, 2) [N m] and the next state."""
        rows = instant(observation)
        past = np.zeros((len(rows), 2 * JOINTS * PAST), dtype=np.float32) if state is None else state.copy()
        past[np.asarray(episode_start, dtype=bool)] = 0.0
        with torch.no_grad():
            action = torch.tanh(self.network(torch.from_numpy(np.concatenate([rows, past], axis=-1)))) * LIMIT
        return action.double().numpy(), np.concatenate([rows[:, : 2 * JOINTS], past[:, : -2 * JOINTS]], axis=-1)


def network(inputs: int, outputs: int) -> nn.Sequential:
    """Return a network with two hidden layers."""
    return nn.Sequential(
        nn.Linear(inputs, WIDTH), nn.ReLU(), nn.Linear(WIDTH, WIDTH), nn.ReLU(), nn.Linear(WIDTH, outputs)
    )


def scored(policy: Cloned, provenance: dict) -> str:
    """Return what the policy reaches in episodes that are not in the data."""
    condition = provenance["settings"]["condition"]
    episodes = list(record(policy, condition, TESTED[condition], TESTED_SEED))
    score, _ = score_of(episodes, condition)
    error = 1e3 * np.mean([one.tip_errors.mean() for one in episodes])
    finished = sum(one.completed for one in episodes)
    return f"N {score:.1f}, mean tip error {error:.2f} mm, {finished} of {len(episodes)} episodes to the end"


def arguments_of(description: str) -> argparse.Namespace:
    """Return data set, seconds and seed of the command line."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("dataset", help="folder of a data set that fuzzyarm dataset wrote")
    parser.add_argument("--seconds", type=float, default=60.0, help="of processor time to learn; default: %(default)s")
    parser.add_argument("--seed", type=int, default=0, help="default: %(default)s")
    arguments = parser.parse_args()
    try:
        if not 0.0 < arguments.seconds < math.inf:
            raise ValueError(f"seconds = {arguments.seconds} is out of range; allowed: more than 0")
        arguments.dataset = open_dataset(arguments.dataset)
    except ValueError as error:
        parser.exit(2, f"{parser.prog}: {error}\n")
    torch.set_num_threads(1)  # for networks this small more threads are not faster
    torch.manual_seed(arguments.seed)
    return arguments


def main() -> None:
    """Learn, and print the score."""
    arguments = arguments_of(__doc__.splitlines()[0])
    inputs, labels = [], []
    for episode in arguments.dataset.iterate_episodes():
        inputs.append(with_past(instant(episode.observations[:-1])))
        labels.append(episode.infos["intended_action"])  # what the policy wanted, without the noise
    features = torch.from_numpy(np.concatenate(inputs))
    targets: Tensor = torch.from_numpy(np.concatenate(labels)).float() / LIMIT
    policy = network(features.shape[1], JOINTS)
    optimizer = torch.optim.Adam(policy.parameters(), lr=LEARNING_RATE)
    begin, updates = time.process_time(), 0
    while (share := (time.process_time() - begin) / arguments.seconds) < 1.0:
        for group in optimizer.param_groups:
            group["lr"] = LEARNING_RATE * (FINAL + (1.0 - FINAL) * (1.0 - share))
        chosen = torch.randint(len(features), (BATCH,))
        loss = nn.functional.mse_loss(torch.tanh(policy(features[chosen])), targets[chosen])
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        updates += 1
    rms = [f"{error:.2f}" for error in loss.item() ** 0.5 * LIMIT]
    print(f"{len(features)} samples, {updates} updates; torques differ by about {' and '.join(rms)} N m (rms)")
    print(f"cloned: {scored(Cloned(policy), provenance_of(arguments.dataset))}")


if __name__ == "__main__":
    main()
