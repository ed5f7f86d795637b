"""The paper's numbers and figures made again: what it says, what we measure, and whether ours have moved."""
