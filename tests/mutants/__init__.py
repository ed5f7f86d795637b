"""Fifty one-line mutants of readers, checks and proofs, and whether the tests that they are mapped to notice each.

python -m tests.mutants                        all of them, to benchmarks/results/mutants.json
python -m tests.mutants shown-lines weights    those whose names hold one of these words
"""
