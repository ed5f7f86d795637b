"""The paper's numbers about its three cases, as data: each has a value for every controller in `controllers.TITLES`."""

from __future__ import annotations

from collections.abc import Mapping

from fuzzyarm.eval.paper import measures as m
from fuzzyarm.eval.paper import reasons
from fuzzyarm.eval.paper.claim import COMPUTED, SIMULATED, SIMULATED_MM, Claim

__all__ = ["ROLLOUTS"]


_ENDS = {
    "largest": ("largest size", m.peak),
    "inmost": ("inmost", m.smallest),
    "outmost": ("outmost", m.largest),
}
"""What is read from a circularity error over time: name in the claim's key, name in its quantity, and the function."""


def _circularity(
    number: int, case: str, side: str, says: str, papers: Mapping[str, float | None], reason: str
) -> list[Claim]:
    """Return the claims about the circularity error of a case on one side, one for each key of `papers` in `_ENDS`."""
    claims = []
    for end, paper in papers.items():
        quantity, measure = _ENDS[end]
        claims.append(
            Claim(f"case-{number}-{end}-{side}", f"6.2, Fig. {number + 3}", says,
                  f"circularity error, Case {number}, {side}, {quantity}", "mm", paper,
                  m.circularity(case, side, measure), decimals=1, reason=reason, tolerance=SIMULATED_MM)
        )  # fmt: skip
    return claims


_ABOUT = "maximal deviation about 1.3 mm for the two controllers"
_BETWEEN = "the trajectory radius evolves between -2.3 and 4.4 mm"

# What the paper says of its simulations.
ROLLOUTS: tuple[Claim, ...] = (
    *_circularity(1, "nominal", "tip", _ABOUT, {"largest": 1.3}, reasons.CIRCLE),
    *_circularity(1, "nominal", "motors", _ABOUT, {"largest": 1.3}, reasons.CIRCLE),
    *_circularity(2, "machining", "tip", _BETWEEN, {"inmost": -2.3, "outmost": 4.4}, reasons.CIRCLE_FORCE),
    *_circularity(2, "machining", "motors", _BETWEEN, {"inmost": -2.3, "outmost": 4.4}, reasons.CIRCLE_FORCE),
    *_circularity(3, "payload", "tip", "a figure", {"inmost": None, "outmost": None}, reasons.NO_NUMBER),
    *_circularity(3, "payload", "motors", "a figure", {"inmost": None, "outmost": None}, reasons.NO_NUMBER),
    *(
        Claim(f"worst-case-{side}", "6.2", "the worst one being Case 2",
              f"largest circularity error, {side}, Case 2 over Case 3", "-", 1.0, m.worst_case(side),
              comparison="more than", reason=reasons.WORST, tolerance=SIMULATED)
        for side in ("tip", "motors")
    ),
    *(
        Claim(f"peak-torque-{joint}", "6.2, Fig. 7",
              "the maximal required torques are 228 Nm for joint 1 and 47 Nm for joint 2",
              f"largest torque of joint {joint}, Case 1", "N m", paper, m.peak_torque(joint - 1), reason=reasons.PEAKS,
              tolerance=SIMULATED)
        for joint, paper in ((1, 228.0), (2, 47.0))
    ),
    Claim("end", "6.1.3", "executed in a duration of 1.5 s", "end of the shortest episode of the three cases", "s", 1.5,
          m.shortest_episode, decimals=1, tolerance=SIMULATED),
    Claim("feedforward-at-rest", "6.2, L_11", "no number", "torque of joint 1 that L asks for at t = 0", "N m", None,
          m.feedforward_at_rest, reason=reasons.FREE_L, tolerance=COMPUTED),
)  # fmt: skip
