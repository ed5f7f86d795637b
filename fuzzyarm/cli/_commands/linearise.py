"""`fuzzyarm linearise`: the linear models of a policy's loop at one posture, for other tools."""

import math
from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from fuzzyarm.cli._usage import UsageError, claimed_folder
from fuzzyarm.common.console import say, status

__all__ = ["Options"]


@dataclass(frozen=True)
class Options:
    """Linearise the loop of a policy with the sampled elastic arm at a posture, as fuzzyarm margins does.

    Writes the matrices A, B, C, D of plant, open loop and closed loop in discrete time, as linear.npz and linear.mat,
    and figures of step responses and Bode diagrams.
    """

    policy: Annotated[str, Parameter(name="", metavar="NAME|FILE")]
    """Policy: fuzzy-4, computed-torque, ... with or without -tip, elastic-observer, a controller file (.json), or a
    learned policy's folder"""
    _: KW_ONLY
    out: Annotated[Path, Parameter(metavar="DIR")]
    """Folder for the files, created if needed"""
    at: Annotated[str | None, Parameter(metavar="Q1,Q2,...")] = None
    """Joint angles of the posture [rad] (default: where the arm's default path begins)"""
    control_period: Annotated[float, Parameter(metavar="SECONDS")] = 1e-3
    """Time between two torques [s]"""
    robot: Annotated[str | None, Parameter(metavar="NAME|FILE")] = None
    """Robot by name, or TOML file of another arm or robot (default: Table 1 of the paper)"""

    def run(self) -> int:
        """Write the linear models and their figures; print the spectral radius and the gain margins at the posture."""
        from fuzzyarm.envs.periods import checked_period
        from fuzzyarm.envs.physics.equations import chosen_arm
        from fuzzyarm.eval.stability.linear_models import linear_models
        from fuzzyarm.policies import load_policy

        period = checked_period("--control-period", self.control_period)
        posture = None if self.at is None else _angles(self.at)
        arm = chosen_arm(self.robot, None)
        policy = load_policy(self.policy, control_period=period, robot=arm)
        with claimed_folder(self.out):
            with status("linearising"):
                models = linear_models(policy, arm, period, posture)
            files = models.write(self.out)
        lower, upper = models.limits()
        later = models.limits(1.0).upper
        angles = ", ".join(f"{angle:.4g}" for angle in models.posture)
        stable = (
            f"stable from {lower:.2f} to {upper:.2f} times the nominal loop gain (up to {later:.2f} times with one "
            "sample of delay)"
        )
        if math.isnan(lower):
            stable = "unstable at the nominal loop gain"
        say(f"at q = ({angles}) rad, sampled every {1e3 * period:g} ms: spectral radius {models.radius:.4f}, {stable}")
        say("\n".join(f"written to {file}" for file in files))
        return 0


def _angles(text: str) -> list[float]:
    try:
        return [float(angle) for angle in text.split(",")]
    except ValueError:
        raise UsageError(f"--at {text} must be joint angles [rad] separated by commas, such as 0.5,1.2") from None
