"""Learned policies as they are shipped: features, network and files in NumPy; no learning library is needed."""
