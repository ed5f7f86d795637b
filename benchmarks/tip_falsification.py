"""Try to exceed the proven bounds of the tip error, with random plants and with plants that a search breeds.

    python benchmarks/tip_falsification.py [--json FILE] [--only TEXT] [--lanes N]

For each set: N random plants, half of them at corners, then four generations of N, each bred from the tenth with the
largest ratio of a tip error to the bound at the same sample: genes of two parents, a tenth of them new, half of those
at an end of their range. Friction (where any is allowed), tip force and errors of the encoders switch at frequencies
and phases that are bred, too. Plants are integrated as the environment does, with sub-steps of 25 µs; the worst of
each set whose friction obeys the law is integrated again event by event. A ratio counts where the bound is above 1 µm.
The exit code is 1 if an error exceeds its bound. Ten minutes.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from measuring import made_now, options_of, printed, write_rows
from tip_bound import CLAIMS, COUNTED, cells_of, exact_errors, set_of
from tip_plants import Plants, random_genes

from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.policies.tip_bound import TipBound, TipClaim, find_bound
from fuzzyarm.proof.tip.laps import StartBox
from fuzzyarm.proof.tip.plant import SETS as SETS_BY_NAME
from fuzzyarm.proof.tip.plant import PlantSet

GENERATIONS = 4
PARENTS = 0.1  # share of the plants that are bred from
MUTATED = 0.1  # share of the genes that are new
SETS = {"any-friction", "near", "near-late", "stiffness ± 10 %", "payload 0 to 0.5 kg", "force ± 10 %, any course"}
BOX, LAPS = StartBox(5e-4, 2e-5, 0.01, 0.01, 2e-5), 3  # about 1 mm at the tip; how many laps are simulated of all
OWN = (
    TipClaim("fuzzy-4-tip", "nominal", "force of any course to 3 N", PlantSet(force_course=3.0)),
    TipClaim("fuzzy-4-tip", "nominal", "encoders +-10 urad, +-1 mrad/s", PlantSet(noise=(1e-5, 1e-3))),
    TipClaim("smooth-observer", set_name="payload 4.7 to 5 kg", plants=PlantSet(payload=(4.7, 5.0))),
    TipClaim("fuzzy-4-tip", set_name="near, any start, for ever", plants=SETS_BY_NAME["near"], laps="ever", start=BOX),
)


def claims() -> list[TipClaim]:
    """Return what is tried."""
    whole = [claim for claim in CLAIMS if cells_of(claim) is None]
    return [*(claim for claim in whole if set_of(claim) in SETS or claim.policy.startswith("shield")), *OWN]


def ratios(bound: TipBound, genes: np.ndarray) -> np.ndarray:
    """Return the largest ratio of an error to the bound at its sample, by plant."""
    laps = LAPS if bound.later else 1
    tip = np.concatenate([bound.all_laps[min(lap, len(bound.later))].tip for lap in range(laps)])
    counted = tip > COUNTED
    return np.asarray((Plants(bound.claim, genes).tip_errors(laps)[counted] / tip[counted, np.newaxis]).max(axis=0))


def bred(genes: np.ndarray, found: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return the next generation."""
    lanes = genes.shape[1]
    best = genes[:, np.argsort(found)[-max(2, int(PARENTS * lanes)) :]]
    parents = best[:, rng.integers(best.shape[1], size=(2, lanes))]
    children = np.where(rng.uniform(size=genes.shape) < 0.5, parents[:, 0], parents[:, 1])
    fresh = random_genes(lanes, rng)
    children = np.where(rng.uniform(size=genes.shape) < MUTATED, fresh, children)
    children[:, 0] = best[:, -1]
    return np.asarray(children)


def exactly(bound: TipBound, genes: np.ndarray) -> float | None:
    """Return the ratio of one plant (GENES, 1) integrated event by event; None where the set needs more than that."""
    plants = bound.claim.plants
    shielded = bound.claim.policy.startswith("shield")  # what a guest asks for is bred, too
    more = (plants.friction == "any", plants.force_swing, plants.force_course, *plants.noise)
    if shielded or bound.claim.start or any(more):
        return None
    one = Plants(bound.claim, genes)
    fields = ("mass", "inertia", "motor_inertia", "stiffness", "damping", "viscous_friction")
    fields += ("static_friction", "coulomb_friction")
    values: dict[str, Any] = {name: tuple(float(np.ravel(x)[0]) for x in getattr(one.plant, name)) for name in fields}
    arm = dataclasses.replace(ArmParameters(), **values)
    errors = exact_errors(bound.claim, arm, float(one.payload[0]), float(one.force[0]))
    counted = bound.tip > COUNTED
    return float((errors[counted, 0] / bound.tip[counted]).max())


def tried(claim: TipClaim, lanes: int) -> dict[str, Any]:
    """Return the row of a claim."""
    bound, rng, by_generation = find_bound(claim), np.random.default_rng(1), list[float]()
    genes = worst = random_genes(lanes, rng)
    for generation in range(1 + GENERATIONS):
        found = ratios(bound, genes)
        by_generation.append(float(found.max()))
        worst = genes[:, [int(found.argmax())]] if by_generation.index(max(by_generation)) == generation else worst
        genes = bred(genes, found, rng)
    named = {"policy": claim.policy, "case": claim.case, "set": set_of(claim), "plants": lanes * (1 + GENERATIONS)}
    ratio = {"largest_ratio": max(by_generation), "by_generation": by_generation}
    return named | ratio | {"event_by_event": exactly(bound, worst), **made_now()}


def main() -> None:
    """Try every claim; print a line for each and optionally write them."""
    parser = options_of(__doc__)
    parser.add_argument(
        "--only", default="", help="try the claims with this in policy and set, and put them into the file"
    )
    parser.add_argument("--lanes", type=int, default=100)
    options = parser.parse_args()
    names = [(claim.policy, set_of(claim)) for claim in claims()]
    rows = printed(
        tried(claim, options.lanes)
        for claim, name in zip(claims(), names, strict=True)
        if options.only in " ".join(name)
    )
    write_rows(options.json, "tip_falsification.py", rows, names, lambda row: (row["policy"], row["set"]))
    exceeded = [row for row in rows if max(row["largest_ratio"], row["event_by_event"] or 0.0) > 1.0]
    raise SystemExit(1 if exceeded else 0)


if __name__ == "__main__":
    main()
