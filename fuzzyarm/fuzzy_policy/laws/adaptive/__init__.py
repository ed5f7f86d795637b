"""A filter that identifies the arm, its load and its delay during motion, and the law that uses the estimates."""
