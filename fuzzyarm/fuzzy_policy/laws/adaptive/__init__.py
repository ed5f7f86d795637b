"""A filter that identifies the arm, its load and its lateness while it moves, and the law that acts on it."""
