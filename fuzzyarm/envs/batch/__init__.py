"""What is stepped: arms in lanes, in compiled code."""
