"""Helpers for all packages, independent of the arm: checks, documents, files, bisection, the terminal."""
