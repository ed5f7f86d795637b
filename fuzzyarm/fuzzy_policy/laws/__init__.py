"""Fixed control laws as policies; those that are trained are in `fuzzyarm.learned_policy`."""
