"""Matrix inequalities and their proof in exact rational arithmetic."""
