"""Batched simulation: many arms, one per lane, advanced in compiled code."""
