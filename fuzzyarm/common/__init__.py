"""Helpers for all packages that do not depend on the arm: checks, documents, files, bisection, the terminal."""
