"""What is proven: tests of the rigid loop that a certificate describes, and the report of its proof."""
