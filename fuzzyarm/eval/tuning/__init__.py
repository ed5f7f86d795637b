"""The search for the numbers of model-based policies, by the rules that chose the shipped ones."""
