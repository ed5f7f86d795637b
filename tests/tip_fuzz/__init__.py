"""Adversarial tubes: what the proof of the tip error accepts is compared with plants that share no code with it.

    python -m tests.tip_fuzz --minutes 60 --seed 0     an hour's worth, figures to benchmarks/results/tip_fuzz.json
    python -m tests.tip_fuzz --seed 0 --only 17        one try again

A try is a pure function of the seed and its number. `sets` draws a set of plants, a motion and plants of that set;
`forge` makes a tube by plans and centres that the package's own search would not choose, which the checker then
confirms or not; `arm` simulates plants by equations (1) to (3) of the paper; `judge` looks for a plant that leaves
the tube or errs by more than its bound.
"""
