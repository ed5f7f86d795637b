"""Fixed control laws as policies; learned ones are in `fuzzyarm.fuzzy_policy.laws.learned`."""
