"""Generators of bad input, and the rules that say what has to come of it.

    python -m tests.abuse                          everything, with figures, to benchmarks/results/abuse.json
    python -m tests.abuse "robot TOML" --only 17   one try again

Every try is a pure function of the name of its surface and its number. `values` spoils values, `surface` runs a try and
judges it, the other modules have the surfaces.
"""
