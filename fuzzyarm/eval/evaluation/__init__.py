"""Evaluation of policies: runs in the cases, tables, figures, files and ranking."""
