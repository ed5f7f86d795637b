"""Reproduction of the paper's numbers and figures: its values, ours, and whether ours have drifted."""
