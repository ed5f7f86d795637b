"""A filter that identifies the arm, its load and its delay while it moves, and the law that acts on it."""
