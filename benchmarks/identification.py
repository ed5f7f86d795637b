"""How often the 95 % intervals of `fuzzyarm identify` cover the truth, on logs of the simulated arm of Table 1.

    python benchmarks/identification.py [--seeds N] [--duration SECONDS] [--json FILE]

Each seed draws the arm that one begins with: every parameter that a log may tell is 0.7 to 1.4 times the true one. The
motion is suggested for such an arm, and recorded with computed torque that takes the plant for it, encoder noise 1e-5
rad and 1e-3 rad/s, 1 kHz. Once the velocities are in the log, once they are left out.
"""

from __future__ import annotations

import dataclasses
import time
from typing import Any

import numpy as np
from measuring import options_of, printed, write

from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.identification._fit import DEVIATIONS
from fuzzyarm.identification._rigid import UNKNOWNS, arm_of, start_of
from fuzzyarm.identification.excitation import _NOISE as NOISE
from fuzzyarm.identification.excitation import rehearsed, suggested
from fuzzyarm.identification.log import Log
from fuzzyarm.identification.result import identify

LOW, HIGH = 0.7, 1.4


def drawn(truth: ArmParameters, seed: int) -> ArmParameters:
    """Return an arm whose unknown parameters are `LOW` to `HIGH` times the true ones."""
    rng = np.random.default_rng([seed, 1])
    return arm_of(start_of(truth) * rng.uniform(LOW, HIGH, len(UNKNOWNS)), truth)


def found(log: Log, start: ArmParameters, truth: ArmParameters) -> dict[str, Any]:
    """Return estimates, standard errors and the processor time of one log [s]."""
    begin = time.process_time()
    result = identify([log], start)
    return {
        "value": result.fit.theta.tolist(),
        "error": [None if np.isnan(error) else error for error in result.fit.error.tolist()],
        "condition": result.fit.condition,
        "correlation": result.fit.correlation,
        "seconds": time.process_time() - begin,
    }


def summary(runs: list[dict[str, Any]], truth: np.ndarray) -> list[dict[str, Any]]:
    """Return a row for each parameter: how often it is told and covered, and how wide its interval is."""
    rows = []
    for k, one in enumerate(UNKNOWNS):
        told = [run for run in runs if run["error"][k] is not None]
        deviation = np.array([(run["value"][k] - truth[k]) / run["error"][k] for run in told])
        width = [DEVIATIONS * run["error"][k] for run in told]
        rows.append(
            {
                "name": one.name,
                "unit": one.unit,
                "truth": float(truth[k]),
                "half_width": float(np.median(width)) if told else None,
                "told": len(told),
                "covered": int(np.sum(np.abs(deviation) <= DEVIATIONS)),
                "deviation_rms": float(np.sqrt(np.mean(deviation**2))) if told else None,
            }
        )
    return rows


def measure(seeds: int, duration: float) -> dict[str, Any]:
    """Return the document."""
    truth = ArmParameters()
    motion = suggested(drawn(truth, seeds), duration)
    runs: dict[str, list[dict[str, Any]]] = {"angles and velocities": [], "angles alone": []}
    for seed in range(seeds):
        start = drawn(truth, seed)
        log = rehearsed(motion, truth, start, seed)
        runs["angles and velocities"].append(found(log, start, truth))
        if seed % 5 == 0:
            runs["angles alone"].append(found(dataclasses.replace(log, velocity=None), start, truth))
        print(f"seed {seed}: {runs['angles and velocities'][-1]['seconds']:.1f} s", flush=True)
    return {
        "duration": duration,
        "noise": dataclasses.asdict(NOISE),
        "motion": {
            "condition": motion.condition(),
            **{name: part.tolist() for name, part in motion.largest().items()},
        },
        "logs": {
            name: {
                "runs": len(ones),
                "seconds": float(np.median([one["seconds"] for one in ones])),
                "rows": summary(ones, start_of(truth)),
            }
            for name, ones in runs.items()
        },
    }


def main() -> None:
    """Measure, and write the result."""
    parser = options_of(__doc__)
    parser.add_argument("--seeds", type=int, default=40)
    parser.add_argument("--duration", type=float, default=10.0)
    given = parser.parse_args()
    (document,) = printed([measure(given.seeds, given.duration)])
    write(given.json, f"identification.py --seeds {given.seeds} --duration {given.duration:g}", **document)


if __name__ == "__main__":
    main()
