"""Training of `learned-observer`: regression on a teacher that knows plant and load, while the student drives."""
