"""What is proven: the rigid loop that a certificate speaks of, put to the test."""
