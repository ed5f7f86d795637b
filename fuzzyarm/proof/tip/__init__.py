"""A bound on the tip error of the elastic, sampled arm along a reference, proven in ball arithmetic."""
