"""The design problem as an open cvxpy model; cvxpy (extra `cvxpy`) is imported here and nowhere else."""
