"""Design by linear matrix inequalities; the only place that imports cvxpy and clarabel."""
