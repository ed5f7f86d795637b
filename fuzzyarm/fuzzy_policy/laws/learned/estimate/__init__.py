"""A recurrent network beside the elastic observer: what it is, its file, and the policy."""
