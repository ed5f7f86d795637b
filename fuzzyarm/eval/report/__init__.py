"""The page of `fuzzyarm report`: one self-contained HTML file for the folder of an evaluation."""
