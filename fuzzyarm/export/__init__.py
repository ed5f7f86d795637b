"""Export of a law: as a sheet of equations and numbers, and as C."""
