"""How policies rank: policies in the paper's cases, tables, figures and files."""
