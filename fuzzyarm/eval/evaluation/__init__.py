"""Evaluation of policies: episodes of the test cases, their tables, figures and files, and a ranking."""
