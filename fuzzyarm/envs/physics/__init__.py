"""The arm: its parameters, its equations of motion, its friction and its integrators."""
