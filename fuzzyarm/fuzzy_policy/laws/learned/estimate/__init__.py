"""A recurrent network added to the elastic observer: the network, its file, and the policy."""
