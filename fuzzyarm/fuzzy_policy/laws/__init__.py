"""Fixed control laws as policies; those that are trained are in `fuzzyarm.fuzzy_policy.laws.learned`."""
