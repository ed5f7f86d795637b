"""`fuzzyarm report`: one self-contained HTML page from the folder of an evaluation."""
