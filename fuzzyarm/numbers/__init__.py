"""The kinds of number on which equations run: floats, recorded symbols, and machine code compiled from these."""
