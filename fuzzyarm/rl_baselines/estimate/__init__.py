"""Training of `learned-observer`: the student network drives arms and learns from a teacher that knows the load."""
