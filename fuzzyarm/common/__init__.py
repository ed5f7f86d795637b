"""What every room uses and what knows no arm: checks, documents, files, bisection, the terminal."""
