"""The paper's numbers and figures made anew: what it says, what we measure, and whether ours have moved."""
