"""With which kind of number an equation is run: floats, symbols that are recorded, machine code made from these."""
