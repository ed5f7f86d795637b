"""Episodes of named policies as data sets in Minari's format, for imitation and offline learning."""
