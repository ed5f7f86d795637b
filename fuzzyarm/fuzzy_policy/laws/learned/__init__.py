"""Learned policies in the form in which they are shipped: features, network and files, without a learning library."""
