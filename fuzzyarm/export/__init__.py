"""How a law leaves this package: written down with its numbers, and as C."""
