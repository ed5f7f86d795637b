"""Learned policies as they are shipped: features, network and files, without a learning library."""
