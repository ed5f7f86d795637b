"""`fuzzyarm sweep`: policies on thousands of plants, in chunks, on this machine's cores or on a Ray cluster."""
